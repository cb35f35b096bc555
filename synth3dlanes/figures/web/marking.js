"use strict";

// Lines are drawn in the drive's world: metres, x right, y up. The file has them in the frame of the drive's poses.
const data = JSON.parse(document.getElementById("marking-data").textContent);
const map = document.getElementById("map"), told = document.getElementById("told"), rows = document.querySelector("#lines tbody");
const SVG = "http://www.w3.org/2000/svg", REACH_PX = 10, STEP_M = 0.1, LEAP_M = 2, ALONG_M = 20;
const CHOICES = {
  kind: ["delimiter", "centerline"], marking: ["solid", "dashed", "none"], color: ["", "white", "yellow"], direction: ["same", "oncoming"],
};
let lines = linesOf(data.marks, [0, 0]), chosen = lines.length ? 0 : -1, point = -1;
let isDrawing = false, isHeld = false, isSaved = true, drag = null;
const past = [], cross = [...(data.path[0] || [0, 0])], view = { x: cross[0], y: cross[1], metres: 60 };

// What a file of lines holds, as lines of this page: `origin` is taken off.
function linesOf(document, origin) {
  if (document?.type !== "FeatureCollection" || !Array.isArray(document.features)) throw new Error("expected a FeatureCollection");
  const ids = new Set();
  return document.features.map((feature, i) => {
    const points = feature?.geometry?.type === "LineString" ? feature.geometry.coordinates : null;
    if (!points?.every((p) => Array.isArray(p) && p.slice(0, 2).every(Number.isFinite)) || points.length < 2) throw new Error(`feature ${i}: expected a LineString of two points or more`);
    const found = feature.properties || {}, line = { id: String(found.id || `marked${i + 1}`), points: points.map(([x, y]) => [x - origin[0], y - origin[1]]) };
    if (ids.has(line.id)) throw new Error(`feature ${i}: expected every id once, got ${line.id} twice`);
    ids.add(line.id);
    for (const [key, values] of Object.entries(CHOICES)) {
      line[key] = found[key] ?? values[0];
      if (!values.includes(line[key])) throw new Error(`feature ${i}: ${key}: expected one of ${values.join(", ")}`);
    }
    return line;
  });
}

function fileText() {
  const rounded = (value) => Math.round(value * 1000) / 1000;
  const features = lines.map(({ id, kind, marking, color, direction, points }) => ({
    type: "Feature", properties: { id, kind, marking, color: color || null, direction },
    geometry: { type: "LineString", coordinates: points.map(([x, y]) => [rounded(x + data.origin[0]), rounded(y + data.origin[1])]) },
  }));
  return JSON.stringify({ type: "FeatureCollection", format: data.marks.format, version: data.marks.version, drive: data.drive, features }, null, 1) + "\n";
}

function changed() { past.push(JSON.stringify([lines, chosen, point, isDrawing])); isSaved = false; if (past.length > 500) past.shift(); }
const line = () => lines[chosen];
const length = (points) => points.slice(1).reduce((sum, [x, y], i) => sum + Math.hypot(x - points[i][0], y - points[i][1]), 0);
const metresPerPx = () => view.metres / map.clientWidth;
const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

const does = {
  begin() {
    does.finish();
    changed();
    let number = lines.length + 1;
    while (lines.some(({ id }) => id === `marked${number}`)) number += 1;
    lines.push({ id: `marked${number}`, points: [], kind: "delimiter", marking: "solid", color: "", direction: "same" });
    [chosen, point, isDrawing, isHeld] = [lines.length - 1, -1, true, false];
  },
  put() {
    if (isDrawing) {
      const last = line().points.at(-1);
      if (last && apart(last, cross) < 0.01) return;
      changed();
      point = line().points.push([...cross]) - 1;
    } else if (isHeld) isHeld = false;
    else if (take(cross, Infinity)) { changed(); isHeld = true; cross.splice(0, 2, ...line().points[point]); }
  },
  finish() {
    if (isDrawing && line().points.length < 2) { lines.splice(chosen, 1); chosen = lines.length - 1; point = -1; }
    isDrawing = isHeld = false;
  },
  giveUp() {
    if (isDrawing) { line().points = []; does.finish(); } else if (isHeld) does.undo();
  },
  insert() {
    if (isDrawing || !line()) return;
    changed();
    const distances = line().points.slice(1).map((end, i) => toSegment(cross, line().points[i], end));
    point = distances.indexOf(Math.min(...distances)) + 1;
    line().points.splice(point, 0, [...cross]);
  },
  removePoint() {
    if (!line()?.points[point]) return;
    if (!isDrawing && line().points.length < 3) return does.removeLine();
    changed();
    line().points.splice(point, 1);
    point = Math.min(point, line().points.length - 1);
    isHeld = false;
  },
  removeLine() {
    if (!line()) return;
    changed();
    lines.splice(chosen, 1);
    [chosen, point, isDrawing, isHeld] = [Math.min(chosen, lines.length - 1), -1, false, false];
  },
  reverse() { if (line() && !isDrawing) { changed(); line().points.reverse(); point = point < 0 ? -1 : line().points.length - 1 - point; } },
  undo() { if (past.length) { [lines, chosen, point, isDrawing] = JSON.parse(past.pop()); isHeld = isSaved = false; } },
  zoomIn() { zoom(0.8, cross); },
  zoomOut() { zoom(1.25, cross); },
  save() {
    does.finish();
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([fileText()], { type: "application/geo+json" }));
    link.download = `${data.drive.replace(/[^\w.-]+/g, "_")}.geojson`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    isSaved = true;
  },
  nextLine(step) { does.finish(); if (lines.length) { chosen = (chosen + step + lines.length) % lines.length; point = -1; does.nextPoint(1); } },
  nextPoint(step) {
    if (!line()?.points.length || isDrawing) return;
    isHeld = false;
    point = (point + step + line().points.length) % line().points.length;
    move(line().points[point]);
  },
  along(step) {
    const at = data.path.map((place) => apart(place, cross)), nearest = at.indexOf(Math.min(...at));
    let i = nearest, way = 0;
    while (data.path[i + step] && way < ALONG_M) { way += apart(data.path[i], data.path[i + step]); i += step; }
    move(data.path[i]);
    [view.x, view.y] = cross;
  },
};

function toSegment(place, a, b) {
  const along = [b[0] - a[0], b[1] - a[1]], size = along[0] ** 2 + along[1] ** 2 || 1;
  const share = Math.min(1, Math.max(0, ((place[0] - a[0]) * along[0] + (place[1] - a[1]) * along[1]) / size));
  return apart(place, [a[0] + share * along[0], a[1] + share * along[1]]);
}

// Choose the point within reach that is nearest to a place, first of the chosen line; tell whether there is one.
function take(place, reach) {
  const all = lines.flatMap(({ points }, i) => points.map((p, j) => [apart(p, place) - (i === chosen ? 1e-6 : 0), i, j]));
  const [distance, i, j] = all.reduce((a, b) => (b[0] < a[0] ? b : a), [Infinity]);
  if (!(distance < reach) && !(reach === Infinity && i !== undefined)) return false;
  [chosen, point] = [i, j];
  return true;
}

function takeLine(place, reach) {
  const all = lines.map(({ points }) => Math.min(...points.slice(1).map((end, i) => toSegment(place, points[i], end))));
  const best = all.indexOf(Math.min(...all));
  if (all[best] < reach) [chosen, point] = [best, -1];
}

function move(place) {
  cross.splice(0, 2, ...place);
  if (isHeld) line().points[point] = [...cross];
  const half = [view.metres / 2, (view.metres / map.clientWidth) * map.clientHeight / 2];
  if (Math.abs(cross[0] - view.x) > 0.95 * half[0] || Math.abs(cross[1] - view.y) > 0.95 * half[1]) [view.x, view.y] = cross;
}

function zoom(factor, at) {
  const metres = Math.min(5000, Math.max(2, view.metres * factor)), share = metres / view.metres;
  [view.x, view.y, view.metres] = [at[0] + (view.x - at[0]) * share, at[1] + (view.y - at[1]) * share, metres];
}

function placeOf(event) {
  const box = map.getBoundingClientRect(), scale = view.metres / box.width;
  return [view.x + (event.clientX - box.left - box.width / 2) * scale, view.y - (event.clientY - box.top - box.height / 2) * scale];
}

// The picture: what stands still is made once.
const ground = make("g", map, {}), drawn = make("g", map, {});
function make(name, parent, attributes) {
  const part = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) part.setAttribute(key, value);
  parent.append(part);
  return part;
}
const pictures = data.tiles.map((tile) => {
  const place = { x: tile.x, y: -tile.y - data.tile_m, width: data.tile_m, height: data.tile_m, preserveAspectRatio: "none" };
  const [intensity, height] = ["intensity", "height"].map((what) => make("image", ground, { ...place, class: what, href: tile[what] }));
  return { intensity, height };
});
const svgPoints = (points) => points.map(([x, y]) => `${x},${-y}`).join(" ");

function draw() {
  const px = metresPerPx(), tall = px * map.clientHeight;
  map.setAttribute("viewBox", `${view.x - view.metres / 2} ${-view.y - tall / 2} ${view.metres} ${tall}`);
  const isHeight = document.getElementById("show-height").checked;
  for (const { intensity, height } of pictures) { intensity.classList.toggle("off", isHeight); height.classList.toggle("off", !isHeight); }
  drawn.replaceChildren();
  const grid = { class: "grid", "vector-effect": "non-scaling-stroke" }, step = view.metres > 400 ? 100 : 10;
  for (let x = Math.ceil((view.x - view.metres / 2) / step) * step; x < view.x + view.metres / 2; x += step) make("path", drawn, { ...grid, d: `M${x},${-view.y - tall / 2}v${tall}` });
  for (let y = Math.ceil((view.y - tall / 2) / step) * step; y < view.y + tall / 2; y += step) make("path", drawn, { ...grid, d: `M${view.x - view.metres / 2},${-y}h${view.metres}` });
  make("polyline", drawn, { class: "path", points: svgPoints(data.path) });
  lines.forEach(({ points, color, kind }, i) => {
    make("polyline", drawn, { class: `marked ${kind} ${color}${i === chosen ? " chosen" : ""}`, points: svgPoints(points) });
    if (i === chosen) points.forEach(([x, y], j) => make("circle", drawn, { class: j === point ? "point taken" : "point", cx: x, cy: -y, r: (j === point ? 6 : 4) * px }));
    const [end, before] = [points.at(-1), points.at(-2)];
    if (before) {
      const turn = Math.atan2(-(end[1] - before[1]), end[0] - before[0]);
      make("path", drawn, { class: "head", transform: `translate(${end[0]} ${-end[1]}) rotate(${turn * 180 / Math.PI}) scale(${px})`, d: "M12,0L-4,-6V6z" });
    }
  });
  make("path", drawn, { class: "cross", d: `M${cross[0] - 12 * px},${-cross[1]}h${24 * px}M${cross[0]},${-cross[1] - 12 * px}v${24 * px}` });
  showRows();
  const what = isDrawing ? `drawing ${line().id}` : line() ? `${line().id}${point >= 0 ? `, point ${point + 1}${isHeld ? " taken" : ""}` : ""}` : "no line";
  told.textContent = `${lines.length} line${lines.length === 1 ? "" : "s"}; ${what}; cross at ${cross.map((value, i) => (value + data.origin[i]).toFixed(1)).join(", ")} m${isSaved ? "" : "; not saved"}`;
}

// A row for each line; made anew where lines were added or removed, so that a select keeps its focus.
function showRows() {
  if (rows.dataset.ids !== lines.map(({ id }) => id).join(" ")) {
    rows.dataset.ids = lines.map(({ id }) => id).join(" ");
    rows.replaceChildren(...lines.map(({ id }, i) => {
      const row = document.createElement("tr"), button = document.createElement("button");
      button.textContent = id;
      button.addEventListener("click", () => { does.finish(); chosen = lines.findIndex((found) => found.id === id); point = -1; does.nextPoint(1); draw(); });
      row.insertCell().append(button);
      for (const [key, values] of Object.entries(CHOICES)) {
        const select = document.createElement("select");
        select.setAttribute("aria-label", `${key} of ${id}`);
        select.append(...values.map((value) => new Option(value || "unknown", value)));
        select.addEventListener("change", () => { changed(); lines.find((found) => found.id === id)[key] = select.value; draw(); });
        row.insertCell().append(select);
      }
      for (const name of ["count", "metres"]) row.insertCell().className = `number ${name}`;
      return row;
    }));
  }
  [...rows.children].forEach((row, i) => {
    Object.keys(CHOICES).forEach((key, k) => { row.cells[k + 1].firstChild.value = lines[i][key]; });
    row.classList.toggle("chosen", i === chosen);
    row.querySelector(".count").textContent = lines[i].points.length;
    row.querySelector(".metres").textContent = length(lines[i].points).toFixed(1);
  });
}

const KEYS = {
  n: () => does.begin(), " ": () => does.put(), Enter: () => does.finish(), Escape: () => does.giveUp(), i: () => does.insert(),
  "[": () => does.nextLine(-1), "]": () => does.nextLine(1), ",": () => does.nextPoint(-1), ".": () => does.nextPoint(1),
  Delete: (event) => (event.shiftKey ? does.removeLine() : does.removePoint()), Backspace: () => does.removePoint(), r: () => does.reverse(), u: () => does.undo(),
  "+": () => does.zoomIn(), "=": () => does.zoomIn(), "-": () => does.zoomOut(), PageUp: () => does.along(1), PageDown: () => does.along(-1),
};
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
map.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const arrow = ARROWS[event.key], step = event.shiftKey ? LEAP_M : STEP_M;
  if (arrow) { if (isHeld) isSaved = false; move([cross[0] + step * arrow[0], cross[1] + step * arrow[1]]); } else if (KEYS[event.key]) KEYS[event.key](event);
  else return;
  event.preventDefault();
  draw();
});
map.addEventListener("pointerdown", (event) => {
  if (event.button) return;
  const place = placeOf(event);
  map.focus();
  map.setPointerCapture(event.pointerId);
  isHeld = false;
  const isTaken = !isDrawing && take(place, REACH_PX * metresPerPx());
  drag = { at: [event.clientX, event.clientY], view: [view.x, view.y], isTaken, isMoved: false };
  draw();
});
map.addEventListener("pointermove", (event) => {
  if (!drag) return;
  const [right, down] = [event.clientX - drag.at[0], event.clientY - drag.at[1]];
  if (!drag.isMoved && Math.hypot(right, down) < 3) return;
  if (drag.isTaken) {
    if (!drag.isMoved) changed();
    line().points[point] = placeOf(event);
    cross.splice(0, 2, ...placeOf(event));
  } else [view.x, view.y] = [drag.view[0] - right * metresPerPx(), drag.view[1] + down * metresPerPx()];
  drag.isMoved = true;
  draw();
});
map.addEventListener("pointerup", (event) => {
  if (!drag) return;
  const { isMoved, isTaken } = drag;
  drag = null;
  if (isMoved) return draw();
  cross.splice(0, 2, ...placeOf(event));
  if (isDrawing) does.put(); else if (!isTaken) takeLine(cross, REACH_PX * metresPerPx());
  draw();
});
map.addEventListener("pointercancel", () => { drag = null; });
map.addEventListener("dblclick", () => { does.finish(); draw(); });
map.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(event.deltaY / 500), placeOf(event)); draw(); }, { passive: false });
for (const button of document.querySelectorAll("[data-does]")) button.addEventListener("click", () => { does[button.dataset.does](); draw(); if (button.dataset.does === "begin") map.focus(); });
document.getElementById("show-height").addEventListener("change", draw);
document.getElementById("file").addEventListener("change", async (event) => {
  const file = event.target.files[0];
  try {
    const found = linesOf(JSON.parse(await file.text()), data.origin);
    does.finish();
    changed();
    [lines, chosen, point, isDrawing, isSaved] = [found, found.length ? 0 : -1, -1, false, true];
    draw();
  } catch (error) {
    told.textContent = `${file.name}: ${error.message}`;
  }
  event.target.value = "";
});
addEventListener("beforeunload", (event) => { if (!isSaved) event.preventDefault(); });
new ResizeObserver(draw).observe(map);
draw();

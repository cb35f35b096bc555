"use strict";

const data = JSON.parse(document.getElementById("review-data").textContent);
const told = document.getElementById("told"), list = document.getElementById("frames");
const shown = [...document.querySelectorAll(".reviewed")];
// Metres between places by which a lane is known again.
const NEAR_M = 3;
// Verdicts by the frames and lanes of this page; those of a file on others are kept, and saved again.
const frames = new Map(), lanes = new Map();
let others = { frames: [], lanes: [] }, at = 0, isSaved = true;

const buttons = data.frames.map(({ name }, i) => {
  const button = document.createElement("button");
  button.textContent = name;
  button.addEventListener("click", () => { at = i; show(); });
  list.append(button);
  return button;
});
const laneButtons = [...document.querySelectorAll("[data-lane]")];
const NEXT = { undefined: "rejected", rejected: "accepted", accepted: undefined };
for (const button of laneButtons) button.addEventListener("click", () => {
  const lane = data.lanes.find(({ id }) => id === button.dataset.lane), verdict = NEXT[lanes.get(lane)];
  if (verdict) lanes.set(lane, verdict); else lanes.delete(lane);
  isSaved = false;
  show();
});

function mark(button, name, verdict) {
  button.dataset.verdict = verdict || "";
  button.setAttribute("aria-label", `${name} ${verdict || "no verdict"}`);
}

function show() {
  shown.forEach((frame, i) => frame.classList.toggle("off", i !== at));
  buttons.forEach((button, i) => {
    mark(button, data.frames[i].name, frames.get(data.frames[i]));
    button.setAttribute("aria-current", i === at);
  });
  for (const button of laneButtons) mark(button, button.dataset.lane, lanes.get(data.lanes.find(({ id }) => id === button.dataset.lane)));
  const count = (verdicts, wanted) => [...verdicts.values()].filter((verdict) => verdict === wanted).length;
  const now = data.frames[at], verdict = frames.get(now) || "no verdict";
  const words = [`${now?.name ?? "no frame"}: ${verdict}`, `${count(frames, "accepted")} accepted, ${count(frames, "rejected")} rejected of ${data.frames.length}`];
  if (data.lanes.length) words.push(`${count(lanes, "rejected")} of ${data.lanes.length} lanes rejected`);
  const kept = others.frames.length + others.lanes.length;
  if (kept) words.push(`${kept} verdict${kept > 1 ? "s" : ""} on what is not on this page`);
  if (!isSaved) words.push("not saved");
  told.textContent = words.join("; ");
}

function go(step) { at = Math.min(data.frames.length - 1, Math.max(0, at + step)); show(); }
function judge(verdict) {
  if (!data.frames.length) return;
  if (verdict) frames.set(data.frames[at], verdict); else frames.delete(data.frames[at]);
  isSaved = false;
  if (verdict) go(1); else show();
}

function save() {
  const said = (all, verdicts) => all.filter((one) => verdicts.has(one)).map((one) => ({ ...one, verdict: verdicts.get(one) }));
  const { format, version, source, drive } = data;
  const found = { format, version, source, drive, frames: [...said(data.frames, frames), ...others.frames], lanes: [...said(data.lanes, lanes), ...others.lanes] };
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([JSON.stringify(found, null, 1) + "\n"], { type: "application/json" }));
  link.download = "review.json";
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  isSaved = true;
  show();
}

// A frame is known by its time, or by its name where it has none; a lane by its places, whatever its id is now.
const isSameFrame = (a, b) => (a.time_s ?? null) === (b.time_s ?? null) && (a.time_s != null || a.name === b.name);
function isSameLane(a, b) {
  const near = a.xy.filter(([x, y]) => b.xy.some(([u, v]) => Math.hypot(u - x, v - y) < NEAR_M / 2));
  return near.length > 0 && near.length >= Math.min(a.xy.length, b.xy.length) / 2;
}

function take(found) {
  if (found.format !== data.format || !Array.isArray(found.frames) || !Array.isArray(found.lanes)) throw new Error(`expected ${data.format}`);
  if (found.drive !== data.drive) throw new Error(`expected verdicts on ${data.drive || "pictures of no drive"}, got some on ${found.drive || "others"}`);
  others = { frames: [], lanes: [] };
  for (const [all, verdicts, isSame, rest] of [[data.frames, frames, isSameFrame, others.frames], [data.lanes, lanes, isSameLane, others.lanes]]) {
    verdicts.clear();
    for (const said of rest === others.frames ? found.frames : found.lanes) {
      const one = ["accepted", "rejected"].includes(said.verdict) && all.find((own) => isSame(own, said));
      if (one) verdicts.set(one, said.verdict); else rest.push(said);
    }
  }
  show();
}

async function load(file) {
  try {
    take(JSON.parse(await file.text()));
  } catch (error) {
    told.textContent = `${file.name}: ${error.message}`;
  }
}

const KEYS = { ArrowLeft: () => go(-1), ArrowRight: () => go(1), a: () => judge("accepted"), r: () => judge("rejected"), c: () => judge("") };
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || !KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
});
for (const [id, does] of Object.entries({ previous: () => go(-1), next: () => go(1), accept: KEYS.a, reject: KEYS.r, clear: KEYS.c, save })) document.getElementById(id).addEventListener("click", does);
document.getElementById("file").addEventListener("change", (event) => { load(event.target.files[0]); event.target.value = ""; });
addEventListener("beforeunload", (event) => { if (!isSaved) event.preventDefault(); });
if (data.before) take(data.before); else show();

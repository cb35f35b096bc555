"use strict";

// A checkbox shows or hides what its data-shows selects.
for (const box of document.querySelectorAll("input[data-shows]")) {
  const apply = () => {
    for (const part of document.querySelectorAll(box.dataset.shows)) part.classList.toggle("off", !box.checked);
  };
  box.addEventListener("change", apply);
  apply();
}

// A slider shows one frame of a clip; a button plays them all.
const slider = document.getElementById("frames");
if (slider) {
  const frames = [...document.querySelectorAll(".frame")], button = document.getElementById("play");
  const show = () => {
    const words = frames[slider.value].dataset.words;
    frames.forEach((frame, i) => frame.classList.toggle("off", i !== +slider.value));
    slider.setAttribute("aria-valuetext", words);
    document.querySelector("output[for=frames]").textContent = words;
  };
  let timer = null;
  button.addEventListener("click", () => {
    timer = timer ? clearInterval(timer) : setInterval(() => { slider.value = (+slider.value + 1) % frames.length; show(); }, button.dataset.pauseMs);
    button.textContent = timer ? "stop" : "play";
  });
  slider.addEventListener("input", show);
  show();
}

const data = document.getElementById("space-data");
if (data) showSpace(JSON.parse(data.textContent), document.getElementById("space"), document.getElementById("space-bar"));

// An orbitable view of triangles: x right, y forward, z up, metres. Angles in radians.
function showSpace(space, canvas, bar) {
  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) {
    bar.textContent = "This browser has no WebGL 2, which the 3D view needs.";
    return;
  }
  const program = link(gl,
    `#version 300 es
    uniform mat4 clip_from_road; in vec3 point; in vec3 color; out vec3 place; out vec3 tint;
    void main() { place = point; tint = color; gl_Position = clip_from_road * vec4(point, 1.0);
      gl_PointSize = 3.0; }`,
    `#version 300 es
    precision highp float; in vec3 place; in vec3 tint; out vec4 pixel;
    void main() {
      vec3 across = cross(dFdx(place), dFdy(place));
      float light = 1.0;  // of points
      if (length(across) > 0.0) light = 0.62 + 0.38 * abs(dot(normalize(across), normalize(vec3(0.35, -0.45, 0.82))));
      pixel = vec4(tint * light, 1.0);
    }`);
  const groups = space.groups.map((group) => upload(gl, program, group));
  const view = { ...space.views["behind"] };
  let asked = false;  // for the next frame: a mouse moves several times in one
  const draw = () => {
    if (!asked) requestAnimationFrame(() => { asked = false; render(gl, program, groups, view, space.fov_rad, canvas); });
    asked = true;
  };

  groups.forEach((group) => bar.append(checkbox(group, draw)));
  for (const [name, start] of Object.entries(space.views)) {
    const button = document.createElement("button");
    button.textContent = name;
    button.addEventListener("click", () => { Object.assign(view, start); draw(); });
    bar.append(button);
  }
  steer(canvas, view, draw);
  new ResizeObserver(draw).observe(canvas);
}

function link(gl, vertexText, fragmentText) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertexText], [gl.FRAGMENT_SHADER, fragmentText]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

function upload(gl, program, group) {
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  const attribute = (name, values, type, normalized) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    const place = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, type, normalized, 0, 0);
  };
  attribute("point", bytes(group.vertices), gl.FLOAT, false);
  attribute("color", bytes(group.colors), gl.UNSIGNED_BYTE, true);
  const faces = bytes(group.faces);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  // A group without faces is points, of three floats each.
  return { name: group.name, array, count: faces.length / 4, points: faces.length ? 0 : bytes(group.vertices).length / 12, shown: true };
}

function checkbox(group, draw) {
  const label = document.createElement("label"), box = document.createElement("input");
  box.type = "checkbox";
  box.checked = group.shown;
  box.addEventListener("change", () => { group.shown = box.checked; draw(); });
  label.append(box, " " + group.name);
  return label;
}

// Drag or arrow keys turn; with shift (or the right button) they move; wheel, + and - zoom.
function steer(canvas, view, draw) {
  const turn = (right, down) => {
    view.azimuth_rad -= right / 200;
    view.elevation_rad = Math.min(1.57, Math.max(-0.2, view.elevation_rad + down / 200));
    draw();
  };
  const move = (right, down) => {
    const step = view.distance_m / 500, [c, s] = [Math.cos(view.azimuth_rad), Math.sin(view.azimuth_rad)];
    const [x, y, z] = view.target;
    view.target = [x - step * (right * c + down * s), y + step * (down * c - right * s), z];
    draw();
  };
  const zoom = (out) => {
    view.distance_m = Math.min(600, Math.max(2, view.distance_m * Math.exp(out)));
    draw();
  };
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) (event.shiftKey || event.buttons & 2 ? move : turn)(event.movementX, event.movementY);
  });
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(event.deltaY / 800); }, { passive: false });
  const arrows = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, -20], ArrowDown: [0, 20] };
  const zooms = { "+": -0.2, "=": -0.2, "-": 0.2 };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key in arrows) (event.shiftKey ? move : turn)(...arrows[event.key]);
    else if (event.key in zooms) zoom(zooms[event.key]);
    else return;
    event.preventDefault();
  });
}

function render(gl, program, groups, view, fovRad, canvas) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((size) => Math.round(size * devicePixelRatio));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.clearColor(0.87, 0.91, 0.95, 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.DEPTH_TEST);
  gl.useProgram(program);
  gl.uniformMatrix4fv(gl.getUniformLocation(program, "clip_from_road"), true, clipFromRoad(view, fovRad, canvas.width / canvas.height));
  for (const group of groups.filter((one) => one.shown)) {
    gl.bindVertexArray(group.array);
    if (group.points) gl.drawArrays(gl.POINTS, 0, group.points);
    else gl.drawElements(gl.TRIANGLES, group.count, gl.UNSIGNED_INT, 0);
  }
}

// Row by row. The eye stands `distance_m` from the target, behind it at azimuth 0, above it by the elevation.
function clipFromRoad(view, fovRad, aspect) {
  const [ca, sa, ce, se] = [Math.cos(view.azimuth_rad), Math.sin(view.azimuth_rad), Math.cos(view.elevation_rad), Math.sin(view.elevation_rad)];
  const right = [ca, sa, 0], forward = [-sa * ce, ca * ce, -se], up = [-sa * se, ca * se, ce];
  const eye = view.target.map((value, i) => value - view.distance_m * forward[i]);
  const row = (axis, scale) => [...axis.map((value) => value * scale), -scale * axis.reduce((sum, value, i) => sum + value * eye[i], 0)];
  const [near, far] = [0.3, 1500], focal = 1 / Math.tan(fovRad / 2);
  const depth = row(forward, 1), k = (far + near) / (far - near);
  const clipDepth = depth.map((value, i) => k * value - (i === 3 ? 2 * far * near / (far - near) : 0));
  return new Float32Array([...row(right, focal / aspect), ...row(up, focal), ...clipDepth, ...depth]);
}

"use strict";

const data = JSON.parse(document.getElementById("review-data").textContent);
const told = document.getElementById("told"), list = document.getElementById("frames");
const shown = [...document.querySelectorAll(".reviewed")];
const verdicts = new Map();
let at = 0, isSaved = true;

const buttons = data.names.map((name, i) => {
  const button = document.createElement("button");
  button.textContent = name;
  button.addEventListener("click", () => { at = i; show(); });
  list.append(button);
  return button;
});

function show() {
  shown.forEach((frame, i) => frame.classList.toggle("off", i !== at));
  buttons.forEach((button, i) => {
    const verdict = verdicts.get(data.names[i]) || "";
    button.dataset.verdict = verdict;
    button.setAttribute("aria-current", i === at);
    button.setAttribute("aria-label", `${data.names[i]} ${verdict || "no verdict"}`);
  });
  const count = (wanted) => data.names.filter((name) => verdicts.get(name) === wanted).length;
  const verdict = verdicts.get(data.names[at]) || "no verdict";
  told.textContent = `${data.names[at] ?? "no frame"}: ${verdict}; ${count("accepted")} accepted, ${count("rejected")} rejected of ${data.names.length}${isSaved ? "" : "; not saved"}`;
}

function go(step) { at = Math.min(data.names.length - 1, Math.max(0, at + step)); show(); }
function judge(verdict) {
  if (!data.names.length) return;
  if (verdict) verdicts.set(data.names[at], verdict); else verdicts.delete(data.names[at]);
  isSaved = false;
  if (verdict) go(1); else show();
}

function save() {
  const frames = Object.fromEntries(data.names.filter((name) => verdicts.has(name)).map((name) => [name, verdicts.get(name)]));
  const text = JSON.stringify({ format: data.format, version: data.version, source: data.source, frames }, null, 1) + "\n";
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  link.download = "review.json";
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  isSaved = true;
  show();
}

async function load(file) {
  try {
    const found = JSON.parse(await file.text());
    if (found.format !== data.format || typeof found.frames !== "object") throw new Error(`expected ${data.format}`);
    const names = Object.keys(found.frames).filter((name) => data.names.includes(name));
    if (!names.length && Object.keys(found.frames).length) throw new Error("expected verdicts on frames of this page, got others");
    for (const name of names) if (["accepted", "rejected"].includes(found.frames[name])) verdicts.set(name, found.frames[name]);
    show();
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
for (const [id, does] of Object.entries({ before: () => go(-1), next: () => go(1), accept: KEYS.a, reject: KEYS.r, clear: KEYS.c, save })) document.getElementById(id).addEventListener("click", does);
document.getElementById("file").addEventListener("change", (event) => { load(event.target.files[0]); event.target.value = ""; });
addEventListener("beforeunload", (event) => { if (!isSaved) event.preventDefault(); });
show();

// The page that puts the 68 points on a head. It holds the points and their history; where a dragged point comes to lie, what
// is baked of them and the file are the server's.

import { readGlb } from "./glb.js";
import { View } from "./head.js";

const byId = (id) => document.getElementById(id);
const HAND = "#5aa9ff";
const SURE = [[0.7, "#4cc383", "high confidence"], [0.4, "#ffb74d", "medium"], [0, "#ff6b5e", "low"]];
// Numbers stand above their points, of lower lids and lips below; the corners' beside them.
const BELOW = new Set([31, 32, 33, 34, 35, 40, 41, 46, 47, 55, 56, 57, 58, 59, 65, 66, 67]);
const LEFT = new Set([0, 1, 2, 3, 4, 5, 6, 7, 36, 42, 48, 64]);
const RIGHT = new Set([9, 10, 11, 12, 13, 14, 15, 16, 39, 45, 54, 60]);
// Edges that lie on each other when lids and lips are closed: upper, lower. Drawn this many pixels apart at least.
const EDGES = [[37, 41], [38, 40], [43, 47], [44, 46], [61, 67], [62, 66], [63, 65]];
const APART = 13;
// Smaller than this the numbers would cover each other: pixels between the inner eye corners.
const ROOM = 90;

function say(text, bad = false) {
  byId("said").textContent = text;
  byId("said").classList.toggle("bad", bad);
}

let now = null; // points (vertices), places, normals: 68 each; hand: those set here
let start = null;
const past = [];
let saved = null;
let bakedOf = null;
let head = null;
let rows = new Map(); // vertex of the drawn head by its place
let focus = null;

async function post(path, words = {}) {
  try {
    const all = new URLSearchParams({ ...words, points: now.points.join() });
    const answer = await fetch(`${path}?${all}`, { method: "POST", headers: { "X-Mien": "1" } });
    return await answer.json();
  } catch {
    return { ok: false, said: "no reply from mien-studio; is it still running?" };
  }
}

let view = null;
try {
  view = new View(byId("view"));
} catch (error) {
  say(error.message, true);
}
const ground = () => {
  const colour = getComputedStyle(document.documentElement).getPropertyValue("--stage").trim();
  if (view) view.ground = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255);
};
ground();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", ground);

// Where a point is drawn: moved with the shape that is shown.
const key = (p) => p.map(Math.fround).join();
function shift(k) {
  const d = head?.targets[0]?.entries.get(rows.get(key(now.places[k])));
  const w = Number(byId("weight").value);
  return d ? [w * d[0], w * d[1], w * d[2]] : [0, 0, 0];
}

function onScreen(p) {
  const { view: m, clip } = view.camera;
  const at = (row) => m[row] * p[0] + m[4 + row] * p[1] + m[8 + row] * p[2] + m[12 + row];
  const [x, y, z] = [at(0), at(1), at(2)];
  const { clientWidth, clientHeight } = view.canvas;
  return [(1 - (clip[0] * x) / z) * clientWidth / 2, (1 + (clip[5] * y) / z) * clientHeight / 2];
}

const viewer = () => {
  const { view: m } = view.camera;
  return [0, 1, 2].map((k) => -(m[4 * k] * m[12] + m[4 * k + 1] * m[13] + m[4 * k + 2] * m[14]));
};

// From the viewer through a place on the canvas: from, along.
function ray(x, y) {
  const { view: m, clip } = view.camera;
  const { clientWidth, clientHeight } = view.canvas;
  const [dx, dy] = [((2 * x) / clientWidth - 1) / clip[0], (1 - (2 * y) / clientHeight) / clip[5]];
  return [viewer(), [0, 1, 2].map((k) => m[4 * k] * dx + m[4 * k + 1] * dy - m[4 * k + 2])];
}

const shade = (c) => SURE.find(([least]) => c >= least);
const colour = (k) => (now.hand.has(k) || !start.confidence ? HAND : shade(start.confidence[k])[1]);

const groups = [];
function makePoints() {
  const make = (kind, parent, words) => {
    const made = document.createElementNS(byId("points").namespaceURI, kind);
    for (const [name, value] of Object.entries(words)) made.setAttribute(name, value);
    parent.append(made);
    return made;
  };
  for (let k = 0; k < 68; k++) {
    const group = make("g", byId("points"), { "data-k": k });
    make("circle", group, { class: "reach", r: 11 });
    make("circle", group, { class: "dot", r: 5 });
    const at = LEFT.has(k) ? { x: -8, y: 4, "text-anchor": "end" } : RIGHT.has(k) ? { x: 8, y: 4 } : { x: 0, y: BELOW.has(k) ? 17 : -9, "text-anchor": "middle" };
    make("text", group, at).textContent = k;
    group.addEventListener("pointerdown", (event) => grab(event, k));
    group.addEventListener("dblclick", () => look([k], 0.25));
    groups.push(group);
  }
}

const named = (k) => `${k} ${start.names[k].replaceAll("_", " ")}`;
const isUnsure = (k) => Boolean(start.confidence) && start.confidence[k] < start.low && !now.hand.has(k);
// Points that wait for somebody's word, the least certain first.
const unsure = () => all.filter(isUnsure).sort((a, b) => start.confidence[a] - start.confidence[b]);

// The point that keys move and Confirm is about.
let chosen = null;
function choose(k, near) {
  chosen = k;
  if (near) look([k], Math.min(view.distance, near));
  tell();
}

function tell() {
  const k = chosen;
  if (k === null) return;
  const how = !start.confidence ? "" : now.hand.has(k) ? ", set or confirmed" : `, found with confidence ${start.confidence[k].toFixed(2)}`;
  byId("which").textContent = named(k) + how;
  byId("confirm").disabled = !start.confidence || now.hand.has(k);
}

// Points that look away from the viewer are behind the head.
function drawPoints() {
  const eye = viewer();
  const places = now.places.map((place, k) => place.map((c, axis) => c + shift(k)[axis]));
  const ats = places.map(onScreen);
  const eyes = Math.hypot(ats[39][0] - ats[42][0], ats[39][1] - ats[42][1]);
  for (const [upper, lower] of EDGES) {
    const [p, q] = [ats[upper], ats[lower]];
    const lacks = (APART - (q[1] - p[1])) / 2;
    if (lacks > 0 && Math.abs(p[0] - q[0]) < APART) [p[1], q[1]] = [p[1] - lacks, q[1] + lacks];
  }
  groups.forEach((group, k) => {
    const [p, [x, y]] = [places[k], ats[k]];
    const away = eye.map((c, axis) => c - p[axis]);
    const length = Math.hypot(...away) || 1;
    const faces = now.normals[k].reduce((sum, n, axis) => sum + (n * away[axis]) / length, 0);
    group.style.display = faces > -0.25 ? "" : "none";
    group.setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
    group.style.setProperty("--of", colour(k));
    group.classList.toggle("chosen", k === chosen);
  });
  byId("points").classList.toggle("far", eyes < ROOM);
}

// A drag: the newest place of the pointer is asked for whenever the last answer has come.
let held = null;
function grab(event, k) {
  if (event.button || held) return;
  event.preventDefault();
  const box = view.canvas.getBoundingClientRect();
  const at = onScreen(now.places[k].map((c, axis) => c + shift(k)[axis]));
  held = { k, before: now, off: [at[0] - event.clientX + box.left, at[1] - event.clientY + box.top], wanted: null, busy: false, done: false };
  groups[k].setPointerCapture(event.pointerId);
  groups[k].classList.add("held");
  if (mirrors()) groups[start.partners[k]].classList.add("partner");
  choose(k);
}
addEventListener("pointermove", (event) => {
  if (!held || held.done) return;
  const box = view.canvas.getBoundingClientRect();
  held.wanted = [event.clientX - box.left + held.off[0], event.clientY - box.top + held.off[1]];
  follow();
});
for (const end of ["pointerup", "pointercancel"]) {
  addEventListener(end, () => {
    if (!held) return;
    held.done = true;
    follow();
  });
}
const mirrors = () => byId("mirror").ariaPressed === "true";

async function follow() {
  if (held.busy) return;
  if (!held.wanted) {
    if (held.done) drop();
    return;
  }
  const { k, wanted } = held;
  held.wanted = null;
  held.busy = true;
  const [from, along] = ray(...wanted);
  // The ray is for the neutral head, the pointer is on the shape.
  const d = shift(k);
  const answer = await post("/move", { point: k, mirror: Number(mirrors()), ray: [...from.map((c, axis) => c - d[axis]), ...along].join() });
  held.busy = false;
  take(answer, k);
  follow();
}

// What the server says where points lie now.
function take(answer, k) {
  if (!answer.ok) return say(answer.said, true);
  const hand = new Set(now.hand);
  answer.points.forEach((v, j) => { if (v !== now.points[j]) hand.add(j); });
  // To put a point back where it was is a choice too.
  now = { ...answer, hand: hand.add(k) };
}

function drop() {
  const { before } = held;
  held = null;
  for (const group of groups) group.classList.remove("held", "partner");
  settle(before);
}

// After a move: remembered, told, baked if that is wished.
function settle(before) {
  if (now !== before) {
    past.push(before);
    changed();
    if (byId("live").checked && now.points.join() !== bakedOf) bake();
  }
  tell();
}

// Moves the chosen point to the next vertex in a direction of the screen, right and up.
let stepping = false;
async function step(right, up, count) {
  if (held || stepping || chosen === null) return;
  stepping = true;
  const [before, { view: m }] = [now, view.camera];
  const towards = [0, 1, 2].map((k) => right * m[4 * k] + up * m[4 * k + 1]);
  const sight = [0, 1, 2].map((k) => -m[4 * k + 2]);
  for (let k = 0; k < count; k++) {
    take(await post("/step", { point: chosen, mirror: Number(mirrors()), towards: towards.join(), sight: sight.join() }), chosen);
  }
  stepping = false;
  settle(before);
}

// Somebody has looked: this point is right; on to the next that is unsure.
function confirm() {
  if (chosen === null || byId("confirm").disabled) return;
  past.push(now);
  now = { ...now, hand: new Set(now.hand).add(chosen) };
  changed();
  const [next] = unsure();
  if (next !== undefined) choose(next, 0.3);
  else {
    tell();
    if (bakedOf === null) bake();
  }
}

function changed() {
  const points = now.points.join();
  const unsaved = points !== saved;
  byId("state").dataset.unsaved = Number(unsaved);
  byId("state").textContent = !unsaved ? "saved" : past.length ? "unsaved changes" : start.confidence ? "not saved yet" : "no changes";
  byId("undo").disabled = !past.length;
  byId("stale").hidden = bakedOf === null || bakedOf === points;
  document.title = `${unsaved ? "* " : ""}mien place – ${start.name}`;
  const waiting = unsure();
  byId("first").replaceChildren(...waiting.slice(0, 8).map((k) => {
    const button = Object.assign(document.createElement("button"), { textContent: named(k) });
    button.style.setProperty("--of", colour(k));
    button.addEventListener("click", () => choose(k, 0.3));
    return button;
  }));
  const few = waiting.length === 1;
  byId("about").textContent = !start.confidence ? "Read from the file given." : waiting.length
    ? `Found in a rendering of the head. Bake waits for ${waiting.length} uncertain ${few ? "point" : "points"}: move or confirm ${few ? "it" : "each"}.`
    : "Found in a rendering of the head. Check them all before saving.";
  tell();
}

function undo() {
  if (held || !past.length) return;
  now = past.pop();
  changed();
  if (byId("live").checked) bake();
}

async function load() {
  const name = byId("shape").value;
  const answer = await fetch(`/head.glb?shape=${encodeURIComponent(name)}`);
  const glb = readGlb(await answer.arrayBuffer(), {});
  const fresh = view.load(start.name, glb);
  // Pictures come later than the first drawing.
  Promise.all(glb.materials.map(({ bitmap }) => bitmap)).then(() => { shown = ""; });
  head?.free();
  head = fresh;
  view.heads = [head];
  if (focus) Object.assign(head, focus);
  const { positions } = glb.geometry;
  rows = new Map();
  for (let v = 0; v < positions.length / 3; v++) rows.set(key([...positions.slice(3 * v, 3 * v + 3)]), v);
}

// One bake at a time; what was asked for meanwhile is done after it.
let baking = false;
let again = false;
async function bake() {
  if (baking) {
    again = true;
    return;
  }
  baking = true;
  byId("bake").disabled = true;
  say("baking…");
  const points = now.points.join();
  const answer = await post("/bake", { hand: [...now.hand].join() });
  say(answer.said, !answer.ok);
  if (answer.ok) {
    bakedOf = points;
    const chosen = byId("shape").value || "mouthSmileLeft";
    byId("shape").replaceChildren(...answer.shapes.map((name) => new Option(name, name, false, name === chosen)));
    for (const id of ["shape", "weight"]) byId(id).disabled = false;
    await load();
    changed();
  }
  baking = false;
  byId("bake").disabled = false;
  if (again) {
    again = false;
    if (now.points.join() !== bakedOf) bake();
  }
}

// Looks at the middle of some points from as near as a share of the face.
function look(some, distance) {
  const low = [0, 1, 2].map((axis) => Math.min(...some.map((k) => now.places[k][axis])));
  const high = [0, 1, 2].map((axis) => Math.max(...some.map((k) => now.places[k][axis])));
  focus = { ...focus, centre: low.map((c, axis) => (c + high[axis]) / 2) };
  if (head) Object.assign(head, focus);
  view.distance = distance;
}

const all = [...Array(68).keys()];
function front() {
  const extent = [0, 1, 2].map((axis) => Math.max(...now.places.map((p) => p[axis])) - Math.min(...now.places.map((p) => p[axis])));
  focus = { size: 1.2 * Math.max(...extent) };
  const sum = now.normals.reduce(([x, z], n) => [x + n[0], z + n[2]], [0, 0]);
  view.front();
  view.yaw = Math.atan2(...sum);
  look(all, 1);
  byId("look").value = "0-67";
}

byId("look").addEventListener("change", ({ target }) => {
  const [first, last] = target.value.split("-").map(Number);
  const some = all.slice(first, last + 1);
  const wide = (axis) => Math.max(...some.map((k) => now.places[k][axis])) - Math.min(...some.map((k) => now.places[k][axis]));
  if (first === 0) front();
  else look(some, Math.max(0.2, (1.5 * Math.max(wide(0), wide(1), wide(2))) / focus.size));
});
byId("front").addEventListener("click", front);
byId("undo").addEventListener("click", undo);
byId("bake").addEventListener("click", () => {
  // What it waits for is shown.
  const [first] = unsure();
  if (first !== undefined) choose(first, 0.3);
  bake();
});
byId("confirm").addEventListener("click", confirm);
// Where one looks closely, the view goes along.
const go = (by) => choose(chosen === null ? 0 : (chosen + by + 68) % 68, view.distance < 0.7 ? view.distance : 0);
byId("next").addEventListener("click", () => go(1));
byId("previous").addEventListener("click", () => go(-1));
byId("shape").addEventListener("change", load);
byId("weight").addEventListener("input", ({ target }) => { byId("weighs").textContent = Number(target.value).toFixed(2); });
for (const [id, take] of [["mirror", () => {}], ["wire", (on) => { view.wireframe = on; }]]) {
  byId(id).addEventListener("click", ({ currentTarget }) => {
    const on = currentTarget.ariaPressed !== "true";
    currentTarget.ariaPressed = String(on);
    take(on);
  });
}
byId("save").addEventListener("click", async () => {
  const points = now.points.join();
  const answer = await post("/save");
  say(answer.said, !answer.ok);
  if (!answer.ok) return;
  saved = points;
  changed();
});
addEventListener("keydown", (event) => {
  if ((event.ctrlKey || event.metaKey) && event.key === "z") {
    event.preventDefault();
    undo();
  }
  if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT)$/.test(event.target.tagName)) return;
  const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
  const button = { w: "wire", m: "mirror", r: "front", n: "next", p: "previous", Enter: "confirm" }[event.key];
  // Enter on a button presses that.
  if (!arrow && (!button || (event.key === "Enter" && event.target.tagName === "BUTTON"))) return;
  event.preventDefault();
  if (arrow) step(...arrow, event.shiftKey ? 4 : 1);
  else byId(button).click();
});
addEventListener("beforeunload", (event) => { if (now && now.points.join() !== saved && past.length) event.preventDefault(); });

let shown = "";
let drawn = 0;
function frame() {
  if (head) {
    const weight = Number(byId("weight").value);
    const { yaw, pitch, distance, wireframe, canvas } = view;
    const key = [yaw, pitch, distance, wireframe, view.ground, canvas.clientWidth, canvas.clientHeight, weight, head.centre, now.points].join() + bakedOf + byId("shape").value + [...now.hand].length + chosen;
    if ((key !== shown || head !== frame.head) && view.draw([{ head, weights: new Map(head.targets.map(({ name }) => [name, weight])), pose: null }])) {
      [shown, frame.head] = [key, head];
      drawPoints();
      drawn += 1;
    }
  }
  requestAnimationFrame(frame);
}

async function begin() {
  start = await (await fetch("/start.json")).json();
  now = { points: start.points, places: start.places, normals: start.normals, hand: new Set() };
  byId("why").textContent = start.name;
  byId("file").textContent = `Save writes ${start.out}${start.exists ? ", replacing the existing file" : ""}: the vertex numbers that mien-studio bake --landmarks reads.`;
  byId("mirror").title += start.symmetric ? " (about the middle of the head)" : " (about the middle of the points, as the head is not symmetric)";
  const keys = start.confidence ? SURE.map(([, of, word]) => [of, word]).concat([[HAND, "set or confirmed"]]) : [[HAND, "as given"]];
  byId("key").replaceChildren(...keys.map(([of, word]) => {
    const one = document.createElement("span");
    const dot = one.appendChild(document.createElement("i"));
    dot.style.setProperty("--of", of);
    one.append(word);
    return one;
  }));
  makePoints();
  changed();
  if (!view) return;
  front();
  await load();
  requestAnimationFrame(frame);
  await bake();
}
begin().catch((error) => say(`cannot show this head: ${error.message}`, true));

// For tests and the console.
window.mien = { view, groups, choose, get unsure() { return unsure().length; }, get now() { return now; }, get head() { return head; }, get drawn() { return drawn; }, get baked() { return bakedOf !== null && !baking; }, onScreen };

// The page: what arrives (stream) is shown as heads (head), bars, curves and figures (panels) and the sensor's picture; what
// can be done is in control.

import { Commands, Gains, Receivers, Recorder, Shapes, ask, tabs } from "./control.js";
import { readGlb } from "./glb.js";
import { View } from "./head.js";
import { Bars, Curves, Lamps, figures } from "./panels.js";
import { Picture } from "./picture.js";
import { SetUps } from "./setup.js";
import { Stream } from "./stream.js";
import { STATES, beep } from "./units.js";

const byId = (id) => document.getElementById(id);
const stream = new Stream();
const gains = new Gains(stream);
const shapes = new Shapes();
const recorder = new Recorder(stream);
const bars = new Bars(byId("bars"), (unit, row) => gains.row(unit, row));
const lamps = new Lamps(byId("gestures"), byId("sound"));
const order = (what, user, on) => ask("/command", { what, user, ...(on === undefined ? {} : { on }) });
const setUps = new SetUps(byId("setups"), order, () => byId("sound").checked && beep());
const curves = new Curves(byId("curves"), byId("legend"));
const pictures = [new Picture(byId("picture"), "colour"), new Picture(byId("depth"), "depth")];
const say = (text) => { byId("message").textContent = text; };

let view = null;
try {
  view = new View(byId("view"));
} catch (error) {
  say(`${error.message}; bars and curves still work`);
}

// A target's unit by its name in lower case, for heads that do not say.
const units = fetch("/units.json")
  .then((answer) => answer.json())
  .then((names) => Object.fromEntries(Object.entries(names).map(([name, unit]) => [name.toLowerCase(), unit])));

let receivers = null;
fetch("/words.json").then((answer) => answer.json()).then((words) => {
  receivers = new Receivers(words, stream);
});

// Which shapes follow is known once the source has named its units.
function count() {
  if (!stream.units.length || !view?.heads.length) return;
  say(view.heads.map((head) => `${head.name}: ${head.driven(stream.units)} of ${head.targets.length} shapes follow the face`).join("; "));
}

// How far the heads are loaded: a text, and a share if it is known; nothing when they are there.
function loading(text, share) {
  const [words, bar] = byId("loading").children;
  byId("loading").hidden = !text;
  words.textContent = text;
  if (share === undefined) bar.removeAttribute("value");
  else bar.value = share;
}

async function download(path) {
  const answer = await fetch(path);
  const whole = Number(answer.headers.get("Content-Length"));
  const parts = [];
  let count = 0;
  for (let reader = answer.body.getReader(), part = await reader.read(); !part.done; part = await reader.read()) {
    parts.push(part.value);
    count += part.value.length;
    loading(`Loading the head: ${(count / 1e6).toFixed(1)} of ${(whole / 1e6).toFixed(1)} MB`, count / whole);
  }
  return new Blob(parts).arrayBuffer();
}

async function show(files) {
  if (!view) return loading("");
  try {
    const heads = [];
    for (const { name, bytes } of files) {
      const read = await bytes;
      loading("Preparing the head");
      // That is drawn before the page is busy.
      await new Promise((done) => setTimeout(done, 50));
      heads.push(view.load(name, readGlb(read, await units)));
    }
    view.heads = heads;
    shapes.name(heads);
    count();
  } catch (error) {
    say(`cannot show this head: ${error.message}`);
  }
  loading("");
}

stream.onSource = (source) => {
  byId("source").textContent = source.name;
  document.title = `mien preview – ${source.name}`;
  if (view?.heads.length) return;
  show(source.meshes.map((name, k) => ({ name, bytes: download(`/mesh/${k}`) })));
};
stream.onUnits = count;
stream.onRegions = (regions) => bars.name(regions);
stream.onGesture = (gesture) => lamps.take(gesture);
stream.onSetUp = (facts) => setUps.take(facts.name, facts);
stream.onSample = (sample) => recorder.take(sample, STATES);
stream.open("/events");

// Whose head is shown: a slot's, or everybody's, side by side; and whose bars and curves.
let chosen = null;
let slot = 0;
let tabsOf = "";
const person = (who) => `Person ${who + 1}`;
function whom() {
  const present = stream.present();
  const shown = chosen !== null && present.includes(chosen) ? [chosen] : present;
  if (!shown.includes(slot)) slot = shown[0] ?? chosen ?? 0;
  const key = present.join() + chosen;
  if (key !== tabsOf) {
    tabsOf = key;
    byId("users").replaceChildren(...(present.length > 1 || chosen !== null ? [...present, "all"] : []).map((who) => {
      const tab = document.createElement("button");
      tab.textContent = who === "all" ? "All" : person(who);
      tab.ariaPressed = String(who === (chosen ?? "all"));
      tab.addEventListener("click", () => { chosen = who === chosen || who === "all" ? null : who; });
      return tab;
    }));
    byId("whose").hidden = present.length < 2;
  }
  byId("whose").lastElementChild.textContent = person(slot);
  return shown;
}

// One view is large, the others stand beside it.
const views = [...document.querySelectorAll("#scenes > .view")];
for (const one of views) {
  one.querySelector("button.plate:last-child").addEventListener("click", () => {
    for (const other of views) other.classList.toggle("large", other === one);
  });
}
function arrange() {
  const seen = views.filter((one) => !one.hidden);
  if (byId("scenes").dataset.views !== String(seen.length)) byId("scenes").dataset.views = seen.length;
  if (seen.some((one) => one.classList.contains("large"))) return;
  for (const one of views) one.classList.toggle("large", one === views[0]);
}

const toggle = (id, take) => byId(id).addEventListener("click", (event) => {
  const on = event.currentTarget.ariaPressed !== "true";
  event.currentTarget.ariaPressed = String(on);
  take(on);
});
let posed = true;
toggle("wire", (on) => { if (view) view.wireframe = on; });
toggle("pose", (on) => { posed = on; });
toggle("mirror", (on) => { if (view) view.mirror = on; });
tabs();
byId("pick").addEventListener("click", () => byId("file").click());
byId("file").addEventListener("change", ({ target }) => {
  const files = [...target.files];
  if (files.length) show(files.map((file) => ({ name: file.name, bytes: file.arrayBuffer() })));
  target.value = "";
});
// The ground behind the head: chosen, or the page's own, which follows the system's light or dark.
const ground = () => {
  if (!view) return;
  const colour = byId("ground").value || getComputedStyle(document.documentElement).getPropertyValue("--stage").trim();
  view.ground = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255);
};
ground();
byId("ground").addEventListener("change", ground);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", ground);
byId("reset").addEventListener("click", () => view?.front());
const pause = (paused) => {
  stream.pause(paused);
  byId("play").textContent = paused ? "Play" : "Pause";
};
byId("play").addEventListener("click", () => pause(!stream.paused));
byId("now").addEventListener("click", () => pause(false));
byId("scrub").addEventListener("input", (event) => {
  if (!stream.source?.session) pause(true);
  stream.seek(stream.first + Number(event.target.value) * (stream.last - stream.first));
});
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|BUTTON)$/.test(event.target.tagName)) return;
  const button = { " ": "play", w: "wire", p: "pose", m: "mirror", r: "reset" }[event.key];
  if (!button) return;
  event.preventDefault();
  byId(button).click();
});

const stage = byId("stage");
for (const [name, over] of [["dragover", true], ["dragleave", false], ["drop", false]]) {
  addEventListener(name, (event) => {
    event.preventDefault();
    stage.classList.toggle("over", over);
  });
}
addEventListener("drop", (event) => {
  const files = [...event.dataTransfer.files];
  if (files.length) show(files.map((file) => ({ name: file.name, bytes: file.arrayBuffer() })));
});

const neutral = new Map();
const byUnit = (sample) => (sample ? new Map(stream.units.map((unit, k) => [unit, (sample.w[k] ?? 0) * (gains.of.get(unit) ?? 1)])) : neutral);

let last = performance.now();
let frames = 0;
let chosenAt = 0;
const commands = new Commands(() => slot);
function frame(now) {
  stream.pass(Math.min(0.25, (now - last) / 1000));
  last = now;
  const users = whom();
  const samples = users.map((user) => stream.at(user));
  const sample = samples[users.indexOf(slot)] ?? null;
  if (view) {
    view.held = shapes.now(say);
    const shown = samples.length ? samples : [null];
    const columns = shown.flatMap((one) => view.heads.map((head) => ({ head, weights: byUnit(one), pose: posed ? one?.p : null })));
    if (view.draw(columns)) frames += 1;
    label(columns.map(({ head }, k) => ({
      user: users.length > 1 ? users[Math.floor(k / view.heads.length)] : null,
      head: view.heads.length > 1 ? head.name : "",
    })));
  }
  const window = stream.window(slot);
  if (now - chosenAt > 500) {
    chosenAt = now;
    curves.choose(stream.units, window, bars.chosen);
  }
  bars.draw(sample?.w ?? [], sample?.v, stream.users[slot].ranges, curves.units);
  curves.draw(stream.units, window, stream.empty ? 0 : stream.now(), bars.names);
  const find = (user, number) => stream.users[user].samples.findLast((one) => one.n === number);
  for (const picture of pictures) picture.draw(stream.source?.pictures, samples, stream.unpeopled(), find);
  arrange();
  figures(byId, stream, slot, sample);
  commands.draw(stream.source, sample);
  recorder.draw();
  receivers?.draw();
  if (view) shapes.draw(view.heads);
  byId("now").hidden = !stream.paused || Boolean(stream.source?.session);
  if (!stream.empty) {
    const length = stream.last - stream.first;
    if (document.activeElement !== byId("scrub") || !stream.paused) byId("scrub").value = length > 0 ? (stream.now() - stream.first) / length : 1;
    byId("clock").textContent = stream.source?.session
      ? `${(stream.now() - stream.first).toFixed(1)} of ${length.toFixed(1)} s`
      : stream.paused ? `${(stream.now() - stream.last).toFixed(1)} s` : "live";
  }
  requestAnimationFrame(frame);
}
let labels = "";
// A plate over each head: whose it is, pressed for their bars, and which head.
function label(columns) {
  const key = JSON.stringify([columns, slot]);
  if (key === labels) return;
  labels = key;
  byId("names").replaceChildren(...columns.map(({ user, head }) => {
    const column = document.createElement("span");
    if (user !== null) {
      const plate = Object.assign(document.createElement("button"), { className: "plate", textContent: person(user), title: "show this person's bars and curves" });
      plate.ariaPressed = String(user === slot);
      plate.addEventListener("click", () => { slot = user; });
      column.append(plate, " ");
    }
    if (head) column.append(Object.assign(document.createElement("span"), { className: "plate", textContent: head }));
    return column;
  }));
}
requestAnimationFrame(frame);

// For tests and the console.
window.mien = { stream, get heads() { return view?.heads ?? []; }, get frames() { return frames; }, view, show };

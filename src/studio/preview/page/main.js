// The page: what arrives (stream) is shown as heads (head), bars, curves and figures (panels) and the sensor's picture; what
// can be done is in control.

import { Commands, Gains, Receivers, Recorder, Shapes, tabs } from "./control.js";
import { readGlb } from "./glb.js";
import { View } from "./head.js";
import { Bars, Curves, Lamps, figures } from "./panels.js";
import { Picture } from "./picture.js";
import { STATES, Stream } from "./stream.js";

const byId = (id) => document.getElementById(id);
const stream = new Stream();
const gains = new Gains(stream);
const shapes = new Shapes();
const recorder = new Recorder(stream);
const bars = new Bars(byId("bars"), (unit, row) => gains.row(unit, row));
const lamps = new Lamps(byId("gestures"), byId("sound"));
const curves = new Curves(byId("curves"));
const picture = new Picture(byId("picture"));
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
  bars.words = words;
  bars.name(stream.units);
  receivers = new Receivers(words, stream);
});

// Which shapes follow is known once the source has named its units.
function count() {
  if (!stream.units.length || !view?.heads.length) return;
  say(view.heads.map((head) => `${head.name}: ${head.driven(stream.units)} of ${head.targets.length} shapes follow the face`).join("; "));
}

async function show(files) {
  if (!view) return;
  try {
    const heads = [];
    for (const { name, bytes } of files) heads.push(view.load(name, readGlb(await bytes, await units)));
    view.heads = heads;
    shapes.name(heads);
    count();
  } catch (error) {
    say(`cannot show this head: ${error.message}`);
  }
}

stream.onSource = (source) => {
  byId("source").textContent = source.name;
  document.title = `mien preview – ${source.name}`;
  if (view?.heads.length) return;
  say("preparing the head…");
  show(source.meshes.map((name, k) => ({ name, bytes: fetch(`/mesh/${k}`).then((answer) => answer.arrayBuffer()) })));
};
stream.onSchema = (names) => { bars.name(names); count(); };
stream.onGesture = (gesture) => lamps.take(gesture);
stream.onSample = (sample) => recorder.take(sample, STATES);
stream.open("/events");

// Who is shown: a slot, or everybody who is there, side by side.
let chosen = null;
let tabsOf = "";
function whom() {
  const present = stream.present();
  const key = present.join() + chosen;
  if (key !== tabsOf) {
    tabsOf = key;
    byId("users").replaceChildren(...(present.length > 1 || chosen !== null ? [...present, "all"] : []).map((who) => {
      const tab = document.createElement("button");
      tab.textContent = who === "all" ? "all" : `person ${who + 1}`;
      tab.ariaPressed = String(who === (chosen ?? "all"));
      tab.addEventListener("click", () => { chosen = who === chosen || who === "all" ? null : who; });
      return tab;
    }));
  }
  return chosen !== null && present.includes(chosen) ? [chosen] : present;
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
let slot = 0;
const commands = new Commands(() => slot);
function frame(now) {
  stream.pass(Math.min(0.25, (now - last) / 1000));
  last = now;
  const users = whom();
  slot = users[0] ?? chosen ?? 0;
  const samples = users.map((user) => stream.at(user));
  const sample = samples[0] ?? null;
  if (view) {
    view.held = shapes.now(say);
    const shown = samples.length ? samples : [null];
    const columns = shown.flatMap((one) => view.heads.map((head) => ({ head, weights: byUnit(one), pose: posed ? one?.p : null })));
    if (view.draw(columns)) frames += 1;
    label(columns.map(({ head }, k) => {
      const user = users[Math.floor(k / view.heads.length)];
      return columns.length > 1 ? [users.length > 1 ? `person ${user + 1}` : "", view.heads.length > 1 ? head.name : ""].filter(Boolean).join(" · ") : "";
    }));
  }
  const window = stream.window(slot);
  if (now - chosenAt > 500) {
    chosenAt = now;
    curves.choose(stream.units, window, bars.chosen);
  }
  bars.draw(sample?.w ?? [], stream.users[slot].ranges, curves.colours);
  curves.draw(stream.units, window, stream.empty ? 0 : stream.now(), bars.names);
  picture.draw(stream.source?.pictures, samples, stream.unpeopled(), (user, number) => stream.users[user].samples.findLast((one) => one.n === number));
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
function label(texts) {
  const key = texts.join("|");
  if (key === labels) return;
  labels = key;
  byId("names").replaceChildren(...texts.map((text) => Object.assign(document.createElement("span"), { textContent: text })));
}
requestAnimationFrame(frame);

// For tests and the console.
window.mien = { stream, get heads() { return view?.heads ?? []; }, get frames() { return frames; }, view, show };

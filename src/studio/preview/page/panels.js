// Bars, curves and figures beside the head.

import { angles } from "./matrix.js";
import { STATES, WINDOW_S } from "./stream.js";

const SIDES = { L: "left", R: "right" };
const COLOURS = ["#4cb0ff", "#ff8a5c", "#57c785", "#d77cff", "#ffd24c", "#5ce0d8", "#ff6f91", "#a8b8c8"];
// Curves shown unless units are chosen.
const STRONGEST = 6;

// Code, side and words of a unit; a unit that was renamed is its own name.
function meaning(unit, { units, regions }) {
  const [, code, side] = /^(AU\d+)([LR]?)$/.exec(unit) ?? [];
  const known = units[code];
  if (!known) return { plain: unit, about: unit, region: "Other", order: 0 };
  const number = Number(code.slice(2));
  const [region, all] = regions.find(([, numbers]) => numbers.includes(number)) ?? ["Other", []];
  const text = side ? `${known.plain} ${SIDES[side]}` : known.plain;
  return {
    plain: text[0].toUpperCase() + text.slice(1),
    about: `${unit}, ${known.facs}: ${known.does}${side ? ` (the subject's ${SIDES[side]})` : ""}`,
    region,
    order: all.indexOf(number),
  };
}

function element(kind, parent, className = "") {
  const made = document.createElement(kind);
  if (className) made.className = className;
  parent.append(made);
  return made;
}

// A lamp per gesture, how often it went on, and a sound if wanted.
export class Lamps {
  constructor(parent, sound) {
    [this.parent, this.sound, this.lamps] = [parent, sound, new Map()];
  }

  take({ name, u, on }) {
    const key = u === null ? name : `${name} ${u + 1}`;
    if (!this.lamps.has(key)) {
      this.parent.hidden = false;
      const row = element("span", this.parent, "lamp");
      row.textContent = key.replaceAll("_", " ");
      this.lamps.set(key, { row, on: false, count: 0 });
    }
    const lamp = this.lamps.get(key);
    if (on && !lamp.on) {
      lamp.row.dataset.count = lamp.count += 1;
      if (this.sound.checked) this.beep();
    }
    lamp.on = on;
    lamp.row.classList.toggle("on", on);
  }

  beep() {
    const audio = (this.audio ??= new AudioContext());
    const [tone, gain] = [audio.createOscillator(), audio.createGain()];
    tone.connect(gain).connect(audio.destination);
    gain.gain.value = 0.1;
    tone.start();
    tone.stop(audio.currentTime + 0.12);
  }
}

// One row per unit, by region: weight, and below it how far the range is this person's. The learnt numbers are in the title.
export class Bars {
  constructor(parent, gain) {
    this.parent = parent;
    this.gain = gain;
    this.rows = [];
    this.units = [];
    this.chosen = new Set();
    // Replaced by what the server says.
    this.words = { units: {}, regions: [] };
    this.names = new Map();
  }

  name(units) {
    this.units = units;
    this.parent.replaceChildren();
    this.chosen = new Set([...this.chosen].filter((unit) => units.includes(unit)));
    const said = units.map((unit, k) => ({ unit, k, ...meaning(unit, this.words) }));
    this.names = new Map(said.map(({ unit, plain }) => [unit, plain]));
    const regions = [...this.words.regions.map(([region]) => region), "Other"];
    this.rows = regions.flatMap((region) => {
      const rows = said.filter((one) => one.region === region).sort((a, b) => a.order - b.order || a.k - b.k);
      if (rows.length && this.words.regions.length) element("div", this.parent, "region").textContent = region;
      return rows.map((one) => this.row(one));
    });
  }

  row({ unit, k, plain, about }) {
    const row = element("div", this.parent, "unit");
    row.dataset.unit = unit;
    const name = element("span", row, "name");
    name.textContent = plain;
    if (plain !== unit) element("small", name).textContent = unit;
    const scale = element("div", row, "scale");
    const bar = element("div", scale, "bar");
    const fill = element("i", bar);
    const ready = element("i", element("div", scale, "ready"));
    const value = element("span", row, "value");
    this.gain(unit, row);
    row.addEventListener("click", () => {
      if (!this.chosen.delete(unit)) this.chosen.add(unit);
    });
    bar.dataset.unit = unit;
    return { unit, k, row, name, bar, fill, ready, value, about, told: undefined };
  }

  // Weights and ranges in the order of the units; `colours` by unit where there is a curve.
  draw(weights, ranges, colours) {
    for (const row of this.rows) {
      const weight = weights[row.k] ?? 0;
      row.fill.style.transform = `scaleX(${Math.min(1, weight)})`;
      row.bar.classList.toggle("over", weight > 1);
      row.bar.dataset.weight = weight;
      const text = weight < 0.005 ? "0" : weight.toFixed(2).replace(/^0/, "");
      if (row.value.textContent !== text) row.value.textContent = text;
      row.name.style.borderColor = colours.get(row.unit) ?? "transparent";
      const range = ranges?.[row.k] ?? null;
      if (range === row.told) continue;
      row.told = range;
      const ready = range?.[3] ?? null;
      row.ready.parentElement.style.visibility = ready === null ? "hidden" : "visible";
      row.ready.style.transform = `scaleX(${ready ?? 0})`;
      const learnt = range ? `\nlearned: low ${range[0].toFixed(2)}, rest ${range[1].toFixed(2)}, high ${range[2].toFixed(2)}` : "\nno ranges received: set ranges = true under [osc] of mien";
      row.row.title = `${row.about}${learnt}${ready === null ? "" : `\n${Math.round(100 * ready)} % of the range is this person's own`}\nclick to pin its curve`;
    }
  }
}

// The last 30 s of the chosen units, or of those that moved most.
export class Curves {
  constructor(canvas) {
    this.canvas = canvas;
    this.colours = new Map();
  }

  choose(units, samples, chosen) {
    let shown = [...chosen];
    if (!shown.length) {
      const reach = units.map((unit, k) => {
        let [low, high] = [Infinity, -Infinity];
        for (let i = 0; i < samples.length; i += 3) {
          const w = samples[i].w[k] ?? 0;
          low = Math.min(low, w);
          high = Math.max(high, w);
        }
        return [high - low, unit];
      });
      reach.sort((a, b) => b[0] - a[0]);
      shown = reach.slice(0, STRONGEST).filter(([r]) => r > 0.1).map(([, unit]) => unit);
    }
    // Who had a colour keeps it.
    const kept = new Map(shown.filter((unit) => this.colours.has(unit)).map((unit) => [unit, this.colours.get(unit)]));
    for (const unit of shown) {
      if (!kept.has(unit)) kept.set(unit, COLOURS.find((c) => ![...kept.values()].includes(c)) ?? COLOURS[0]);
    }
    this.colours = kept;
  }

  // `names` are what the units are called, by unit.
  draw(units, samples, now, names) {
    const { canvas } = this;
    const scale = window.devicePixelRatio || 1;
    const style = getComputedStyle(canvas);
    const [faint, dim] = ["--line", "--dim"].map((name) => style.getPropertyValue(name));
    const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const ink = canvas.getContext("2d");
    ink.clearRect(0, 0, width, height);
    ink.font = `${11 * scale}px system-ui, sans-serif`;
    const labels = [...this.colours.keys()].map((unit) => names.get(unit) ?? unit);
    const room = Math.max(60 * scale, ...labels.map((label) => ink.measureText(label).width));
    const [left, right, top, bottom] = [30 * scale, width - room - 12 * scale, 8 * scale, height - 18 * scale];
    const x = (t) => right - ((now - t) / WINDOW_S) * (right - left);
    const y = (w) => bottom - (Math.min(w, 1.2) / 1.2) * (bottom - top);
    ink.lineWidth = scale;
    for (const w of [0, 0.5, 1]) {
      ink.strokeStyle = faint;
      ink.beginPath();
      ink.moveTo(left, y(w));
      ink.lineTo(right, y(w));
      ink.stroke();
      ink.fillStyle = dim;
      ink.fillText(w.toString(), 4 * scale, y(w) + 4 * scale);
    }
    for (let s = 0; s <= WINDOW_S; s += width / scale < 500 ? 10 : 5) {
      ink.fillText(s ? `-${s} s` : "now", x(now - s) - 12 * scale, height - 4 * scale);
    }
    ink.save();
    ink.beginPath();
    ink.rect(left, 0, right - left, height);
    ink.clip();
    ink.lineWidth = 1.6 * scale;
    for (const [unit, colour] of this.colours) {
      const k = units.indexOf(unit);
      ink.strokeStyle = colour;
      ink.beginPath();
      let before = null;
      for (const sample of samples) {
        const w = sample.s === 0 ? undefined : sample.w[k];
        // A gap is a gap.
        if (w === undefined) before = null;
        else {
          if (before === null || sample.t - before > 0.5) ink.moveTo(x(sample.t), y(w));
          else ink.lineTo(x(sample.t), y(w));
          before = sample.t;
        }
      }
      ink.stroke();
    }
    ink.restore();
    let line = 0;
    for (const [unit, colour] of this.colours) {
      ink.fillStyle = colour;
      ink.fillText(names.get(unit) ?? unit, right + 8 * scale, top + (8 + 14 * line++) * scale);
    }
  }
}

// Why nothing moves, in one sentence; or how it is.
function why(stream, sample, silent) {
  const { source, counts } = stream;
  if (!stream.connected) return "Lost the connection to mien-studio, reconnecting; start it again if it has ended.";
  if (counts.note) return counts.note;
  if (stream.empty && source?.kind === "osc") {
    return counts.refused > counts.received
      ? `Something arrives at ${source.name.replace("OSC at ", "")}, but it is not mien's OSC.`
      : `Nothing has arrived at ${source.name.replace("OSC at ", "")} yet: start mien run with this address as the target under [osc].`;
  }
  if (stream.empty) return `Waiting for ${source?.name ?? "the source"}.`;
  if (silent) return "Nothing is arriving: mien has stopped, or the network is down.";
  return sample ? "" : "Connected; nobody is in front of the sensor.";
}

// State, its sentence, and the figures of the session.
export function figures(byId, stream, slot, sample) {
  const text = (id, value) => { if (byId(id).textContent !== value) byId(id).textContent = value; };
  const state = sample ? sample.s : 0;
  const silent = !stream.connected
    ? "not connected"
    : stream.empty
      ? "waiting"
      : !stream.source?.session && !stream.paused && performance.now() - stream.arrived > 1500
        ? "no signal"
        : null;
  text("state", silent ?? STATES[state] + (sample?.f ? ", frozen" : ""));
  byId("state").dataset.state = silent ? 0 : state;
  text("why", why(stream, sample, silent));
  byId("confidence").value = sample?.c ?? 0;
  byId("confidence").title = sample?.c === undefined || sample?.c === null ? "" : `${Math.round(100 * sample.c)} %`;
  text("latency", sample?.l === undefined ? "–" : `${sample.l.toFixed(1)} ms`);
  text("rate", sample ? `${stream.rate(slot).toFixed(0)} Hz` : "–");
  const pose = sample?.p;
  text("place", pose ? pose.slice(0, 3).map((m) => (100 * m).toFixed(0)).join(", ") + " cm" : "–");
  text("turn", pose ? angles(pose.slice(3)).map((a) => `${a.toFixed(0)}°`).join(", ") : "–");
  text("counts", `${stream.counts.received} understood, ${stream.counts.refused} refused`);
}

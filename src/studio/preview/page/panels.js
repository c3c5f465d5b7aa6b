// Bars, curves and figures beside the head.

import { angles } from "./matrix.js";
import { STATES, WINDOW_S } from "./stream.js";

const FACS = {
  1: "inner brow raiser", 2: "outer brow raiser", 4: "brow lowerer", 5: "upper lid raiser", 6: "cheek raiser", 7: "lid tightener",
  9: "nose wrinkler", 10: "upper lip raiser", 11: "nasolabial deepener", 12: "lip corner puller", 14: "dimpler",
  15: "lip corner depressor", 16: "lower lip depressor", 17: "chin raiser", 18: "lip pucker", 20: "lip stretcher", 22: "lip funneler",
  23: "lip tightener", 24: "lip pressor", 25: "lips part", 26: "jaw drop", 27: "mouth stretch", 28: "lip suck", 29: "jaw thrust",
  30: "jaw sideways", 34: "cheek puff", 43: "eye closure", 61: "eyes left", 62: "eyes right", 63: "eyes up", 64: "eyes down",
};
const SIDES = { L: ", subject's left", R: ", subject's right", "": "" };
const COLOURS = ["#4cb0ff", "#ff8a5c", "#57c785", "#d77cff", "#ffd24c", "#5ce0d8", "#ff6f91", "#a8b8c8"];
// Curves shown unless units are chosen.
const STRONGEST = 6;

function meaning(unit) {
  const match = /^AU(\d+)([LR]?)$/.exec(unit);
  return match && FACS[match[1]] ? FACS[match[1]] + SIDES[match[2]] : unit;
}

function element(kind, parent, className = "") {
  const made = document.createElement(kind);
  if (className) made.className = className;
  parent.append(made);
  return made;
}

// One row per unit: weight; where the measure behind it lies between its learnt low and high; those numbers; readiness.
export class Bars {
  constructor(parent) {
    this.parent = parent;
    this.rows = [];
    this.chosen = new Set();
  }

  name(units) {
    this.parent.replaceChildren();
    const head = element("div", this.parent, "unit head");
    for (const text of ["unit", "weight", "rest", "low · rest · high", "ready"]) element("span", head).textContent = text;
    this.chosen = new Set([...this.chosen].filter((unit) => units.includes(unit)));
    this.rows = units.map((unit) => {
      const row = element("div", this.parent, "unit");
      row.title = `${unit}: ${meaning(unit)} – click to keep its curve`;
      row.dataset.unit = unit;
      const name = element("span", row, "name");
      name.textContent = unit;
      const bar = element("div", row, "bar");
      const fill = element("i", bar);
      const span = element("div", row, "span");
      const rest = element("i", span);
      const numbers = element("span", row, "numbers");
      const ready = element("i", element("div", row, "ready"));
      row.addEventListener("click", () => {
        if (!this.chosen.delete(unit)) this.chosen.add(unit);
      });
      return { unit, name, bar, fill, span, rest, numbers, ready, told: undefined };
    });
  }

  // Weights and ranges in the order of the units; `colours` by unit where there is a curve.
  draw(weights, ranges, colours) {
    this.rows.forEach((row, k) => {
      const weight = weights[k] ?? 0;
      row.fill.style.transform = `scaleX(${Math.min(1, weight)})`;
      row.bar.classList.toggle("over", weight > 1);
      row.bar.dataset.weight = weight;
      row.name.style.borderColor = colours.get(row.unit) ?? "transparent";
      const range = ranges?.[k] ?? null;
      if (range === row.told) return;
      row.told = range;
      const known = range && range[2] > range[0];
      row.span.style.visibility = known ? "visible" : "hidden";
      row.numbers.textContent = range ? range.slice(0, 3).map((v) => v.toFixed(2)).join(" · ") : "";
      if (known) row.rest.style.left = `calc(${(100 * (range[1] - range[0])) / (range[2] - range[0])}% - 1px)`;
      const ready = range?.[3] ?? null;
      row.ready.parentElement.style.visibility = ready === null ? "hidden" : "visible";
      row.ready.style.transform = `scaleX(${ready ?? 0})`;
      row.ready.parentElement.title = ready === null ? "" : `how far the range is this person's: ${Math.round(100 * ready)} %`;
    });
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

  draw(units, samples, now) {
    const { canvas } = this;
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const ink = canvas.getContext("2d");
    ink.clearRect(0, 0, width, height);
    ink.font = `${11 * scale}px system-ui, sans-serif`;
    const [left, right, top, bottom] = [30 * scale, width - 74 * scale, 8 * scale, height - 18 * scale];
    const x = (t) => right - ((now - t) / WINDOW_S) * (right - left);
    const y = (w) => bottom - (Math.min(w, 1.2) / 1.2) * (bottom - top);
    ink.lineWidth = scale;
    for (const w of [0, 0.5, 1]) {
      ink.strokeStyle = "#2d333b";
      ink.beginPath();
      ink.moveTo(left, y(w));
      ink.lineTo(right, y(w));
      ink.stroke();
      ink.fillStyle = "#8b95a1";
      ink.fillText(w.toString(), 4 * scale, y(w) + 4 * scale);
    }
    for (let s = 0; s <= WINDOW_S; s += 5) {
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
      ink.fillText(unit, right + 8 * scale, top + (8 + 14 * line++) * scale);
    }
  }
}

// The figures in the head line.
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
  byId("confidence").value = sample?.c ?? 0;
  byId("confidence").title = sample?.c === undefined || sample?.c === null ? "" : `${Math.round(100 * sample.c)} %`;
  text("latency", sample?.l === undefined ? "–" : `${sample.l.toFixed(1)} ms`);
  text("rate", sample ? `${stream.rate(slot).toFixed(0)} Hz` : "–");
  const pose = sample?.p;
  text("place", pose ? pose.slice(0, 3).map((m) => (100 * m).toFixed(0)).join("  ") + " cm" : "–");
  text("turn", pose ? angles(pose.slice(3)).map((a) => a.toFixed(0)).join("  ") + "°" : "–");
  text("counts", `${stream.counts.received} / ${stream.counts.refused}`);
  text("note", stream.counts.note ?? "");
}

// Bars, curves and figures beside the head.

import { drawCurves, drawLegend } from "./drawing.js";
import { angles } from "./matrix.js";
import { WINDOW_S } from "./stream.js";
import { FREEZE, Rows, STATES, beep, element, hue, isRight } from "./units.js";

// Curves shown unless units are chosen.
const STRONGEST = 6;

// A lamp per gesture, how often it went on, and a sound if wanted.
export class Lamps {
  constructor(parent, sound) {
    [this.parent, this.sound, this.lamps] = [parent, sound, new Map()];
  }

  take({ name, u, on }) {
    const key = u === null ? name : `${name}, person ${u + 1}`;
    if (!this.lamps.has(key)) {
      this.parent.hidden = false;
      const row = element("span", this.parent, "lamp");
      row.textContent = key.replaceAll("_", " ");
      this.lamps.set(key, { row, on: false, count: 0 });
    }
    const lamp = this.lamps.get(key);
    if (on && !lamp.on) {
      lamp.row.dataset.count = lamp.count += 1;
      if (this.sound.checked) beep();
    }
    lamp.on = on;
    lamp.row.classList.toggle("on", on);
  }
}

// A row per unit: weight, and below it how far the range is this person's. The learnt numbers are in the title.
export class Bars {
  constructor(parent, gain) {
    [this.parent, this.gain] = [parent, gain];
    [this.rows, this.chosen, this.names] = [null, new Set(), new Map()];
  }

  name(regions) {
    this.rows = new Rows(this.parent, regions);
    const all = this.rows.all;
    this.names = new Map(all.map(({ unit, plain }) => [unit, plain]));
    this.chosen = new Set([...this.chosen].filter((unit) => this.names.has(unit)));
    for (const one of all) {
      one.ready = element("i", element("div", one.scale, "ready"));
      one.name.style.borderLeftStyle = isRight(one.unit) ? "dotted" : "solid";
      this.gain(one.unit, one.row);
      one.row.addEventListener("click", () => {
        if (!this.chosen.delete(one.unit)) this.chosen.add(one.unit);
      });
    }
  }

  // Weights and ranges in the order of the units; `seen` is how far regions can be seen; `curves` are the units that have one.
  draw(weights, seen, ranges, curves) {
    if (!this.rows) return;
    this.rows.draw(weights, seen);
    for (const row of this.rows.all) {
      row.name.style.borderLeftColor = curves.includes(row.unit) ? `oklch(var(--curve) .14 ${hue(row.unit)})` : "transparent";
      const range = ranges?.[row.k] ?? null;
      if (range === row.told) continue;
      row.told = range;
      const ready = range?.[3] ?? null;
      row.ready.parentElement.style.visibility = ready === null ? "hidden" : "visible";
      row.ready.style.transform = `scaleX(${ready ?? 0})`;
      const learnt = range ? `\nlearned: low ${range[0].toFixed(2)}, rest ${range[1].toFixed(2)}, high ${range[2].toFixed(2)}` : "\nno ranges received: set ranges = true under [osc] in mien's configuration";
      row.row.title = `${row.about}${learnt}${ready === null ? "" : `\n${Math.round(100 * ready)} % of the range is this person's own`}\nclick to pin its curve`;
    }
  }
}

// The last 30 s of the chosen units, or of those that moved most.
export class Curves {
  constructor(canvas, legend) {
    [this.canvas, this.legend] = [canvas, legend];
    this.units = [];
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
    // In the order of the units, so that the legend stays as it is.
    this.units = units.filter((unit) => shown.includes(unit));
  }

  // `names` are what the units are called, by unit.
  draw(units, samples, now, names) {
    const curves = this.units.map((unit) => {
      const k = units.indexOf(unit);
      const points = [];
      let before = null;
      for (const sample of samples) {
        const w = sample.s === 0 ? undefined : sample.w[k];
        // A gap is a gap.
        if (w === undefined || (before !== null && sample.t - before > 0.5)) points.push(null);
        if (w !== undefined) points.push([sample.t, Math.min(w, 1.2)]);
        before = w === undefined ? null : sample.t;
      }
      return { hue: hue(unit), dotted: isRight(unit), label: names.get(unit) ?? unit, points };
    });
    const name = (t) => (t > now - 0.01 ? "now" : `-${(now - t).toFixed(0)} s`);
    drawLegend(this.legend, curves);
    drawCurves(this.canvas, { from: now - WINDOW_S, to: now, origin: now, low: 0, high: 1.2, curves, name });
  }
}

// Whether learning is frozen, as the box says.
export const isFrozen = (sample) => Boolean(sample?.f);

// Why nothing moves, in one sentence; or how it is.
function why(stream, sample, silent) {
  const { source, counts } = stream;
  if (!stream.connected) return "The connection to mien-studio is lost; reconnecting. Start it again if it has ended.";
  if (counts.note) return counts.note;
  if (stream.empty && source?.kind === "osc") {
    return counts.refused > counts.received
      ? `Something arrives at ${source.name.replace("OSC at ", "")}, but it is not OSC from mien.`
      : `Nothing has arrived at ${source.name.replace("OSC at ", "")} yet: start mien run with this address as the target under [osc].`;
  }
  if (stream.empty) return `Waiting for ${source?.name ?? "the source"}.`;
  if (silent) return "Nothing arrives any more: mien has stopped, or the network is down.";
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
  text("state", silent ?? STATES[state] + (isFrozen(sample) ? `, ${FREEZE.state}` : ""));
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

// What the page lets be done: commands, recording, gains, shapes by hand, the sweep, receivers.

import { isFrozen } from "./panels.js";
import { FREEZE } from "./units.js";

const byId = (id) => document.getElementById(id);

export function say(text, bad = false) {
  byId("said").textContent = text;
  byId("said").classList.toggle("bad", bad);
}

// Asks mien-studio to change something; the header shows that this page asks.
export async function ask(path, words) {
  try {
    const answer = await fetch(`${path}?${new URLSearchParams(words)}`, { method: "POST", headers: { "X-Mien": "1" } });
    const { ok, said } = await answer.json();
    say(said, !ok);
    return ok;
  } catch {
    say("no reply from mien-studio; is it still running?", true);
    return false;
  }
}

function save(name, parts) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob(parts, { type: "text/plain" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function element(kind, parent, words = {}) {
  const made = Object.assign(document.createElement(kind), words);
  parent.append(made);
  return made;
}

export function tabs() {
  const all = [...document.querySelectorAll("[role=tab]")];
  const choose = (chosen) => all.forEach((tab) => {
    tab.ariaSelected = String(tab === chosen);
    tab.tabIndex = tab === chosen ? 0 : -1;
    byId(tab.getAttribute("aria-controls")).hidden = tab !== chosen;
  });
  all.forEach((tab, k) => {
    tab.addEventListener("click", () => choose(tab));
    tab.addEventListener("keydown", ({ key }) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[key];
      if (!step) return;
      const next = all[(k + step + all.length) % all.length];
      choose(next);
      next.focus();
    });
  });
}

// Neutral, forget and freeze of whoever is shown.
export class Commands {
  constructor(slot) {
    this.slot = slot;
    byId("neutral").addEventListener("click", () => this.send("neutral"));
    byId("forget").addEventListener("click", () => this.send("forget"));
    byId("freeze").addEventListener("click", () => this.send("freeze", { on: Number(byId("freeze").ariaPressed !== "true") }));
  }

  send(what, more = {}) {
    return ask("/command", { what, user: this.slot(), ...more });
  }

  // `sample` says whether somebody is there, and whether the tracker has frozen their ranges, whoever asked for it.
  draw(source, sample) {
    const possible = Boolean(source?.commands && sample);
    for (const id of ["neutral", "freeze", "forget"]) byId(id).disabled = !possible;
    const frozen = isFrozen(sample);
    if (byId("freeze").ariaPressed !== String(frozen)) {
      byId("freeze").ariaPressed = String(frozen);
      byId("freeze").textContent = frozen ? FREEZE.end : FREEZE.wish;
    }
  }
}

const MOST_BYTES = 200e6;

// The weights of everybody as a table that `mien-studio preview --csv` and `animate` read.
export class Recorder {
  constructor(stream) {
    this.stream = stream;
    this.lines = null;
    byId("record").addEventListener("click", () => (this.lines ? this.stop() : this.start()));
  }

  start() {
    const pose = ["tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw"];
    this.units = [...this.stream.units];
    this.lines = [["frame", "time_us", "user", "state", "confidence", ...pose, ...this.units.map((unit) => `w_${unit}`)].join() + "\n"];
    this.bytes = this.lines[0].length;
    this.begun = performance.now();
    byId("record").ariaPressed = "true";
  }

  take(sample, states) {
    if (!this.lines || sample.u < 0 || !sample.w.length) return;
    const line = [sample.n, Math.round(sample.t * 1e6), sample.u, states[sample.s], sample.c ?? "", ...(sample.p ?? Array(7).fill("")), ...this.units.map((_, k) => sample.w[k] ?? 0)].join() + "\n";
    this.lines.push(line);
    this.bytes += line.length;
    if (this.bytes > MOST_BYTES) this.stop();
  }

  stop() {
    const stamp = new Date().toISOString().slice(0, 19).replace(/[-:]/g, "").replace("T", "-");
    save(`mien-${stamp}.csv`, this.lines);
    say(`saved mien-${stamp}.csv: ${this.lines.length - 1} rows, ${(this.bytes / 1e6).toFixed(1)} MB`);
    this.lines = null;
    byId("record").ariaPressed = "false";
    byId("record").textContent = "Record";
  }

  draw() {
    if (!this.lines) return;
    const seconds = Math.floor((performance.now() - this.begun) / 1000);
    const text = `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")} · ${(this.bytes / 1e6).toFixed(1)} MB`;
    if (byId("record").textContent !== text) byId("record").textContent = text;
  }
}

// A slider for every shape of the heads; one that is moved holds its shape, and so does the sweep.
export class Shapes {
  constructor() {
    this.held = new Map();
    this.rows = new Map();
    this.swept = null;
    byId("hands-off").addEventListener("click", () => this.release());
    byId("sweep").addEventListener("click", () => {
      this.swept = this.swept ? null : { begun: performance.now() };
      byId("sweep").ariaPressed = String(Boolean(this.swept));
    });
  }

  release() {
    this.held.clear();
    for (const { row } of this.rows.values()) row.classList.remove("held");
  }

  name(heads) {
    this.release();
    const names = [...new Set(heads.flatMap((head) => head.targets.map(({ name }) => name)))];
    byId("sliders").replaceChildren();
    this.rows = new Map(names.map((name) => {
      const row = element("label", byId("sliders"), { className: "slider" });
      // A name may break where its words begin.
      const word = element("span", row);
      name.split(/(?=[A-Z])/).forEach((part, k) => word.append(...(k ? [document.createElement("wbr"), part] : [part])));
      const slider = element("input", row, { type: "range", min: 0, max: 1, step: 0.01, value: 0 });
      const output = element("output", row, { textContent: "0.00" });
      slider.addEventListener("input", () => {
        this.held.set(name, Number(slider.value));
        row.classList.add("held");
      });
      return [name, { row, slider, output }];
    }));
  }

  // What holds at this moment, by name; null if nothing does.
  now(message) {
    if (!this.swept) return this.held.size ? this.held : null;
    const names = [...this.rows.keys()];
    const at = (performance.now() - this.swept.begun) / 900;
    const name = names[Math.floor(at)];
    if (name === undefined) {
      this.swept = null;
      byId("sweep").ariaPressed = "false";
      message("");
      return this.now(message);
    }
    message(`sweep: ${name} (${Math.floor(at) + 1} of ${names.length})`);
    const all = new Map(names.map((one) => [one, 0]));
    return all.set(name, 1 - Math.abs(2 * (at % 1) - 1));
  }

  draw(heads) {
    if (byId("shapes").hidden) return;
    for (const head of heads.slice(0, 1)) {
      head.targets.forEach(({ name }, k) => {
        const { slider, output } = this.rows.get(name) ?? {};
        if (!slider) return;
        const text = head.weights[k].toFixed(2);
        if (output.textContent === text) return;
        output.textContent = text;
        if (document.activeElement !== slider) slider.value = head.weights[k];
      });
    }
  }
}

// A factor for each unit, tried on the head here and saved: in the configuration that mien-studio was given, else as its lines.
export class Gains {
  constructor(stream) {
    this.of = new Map();
    byId("gains").addEventListener("click", ({ currentTarget }) => {
      const on = currentTarget.ariaPressed !== "true";
      currentTarget.ariaPressed = String(on);
      byId("bars").classList.toggle("gains", on);
      for (const id of ["gains-save", "gains-reset", "gains-about"]) byId(id).hidden = !on;
    });
    byId("gains-save").addEventListener("click", async () => {
      if (!stream.source?.configuration) {
        save("gains.toml", [this.toml()]);
        say("saved gains.toml: put its lines into mien's configuration, or start mien-studio preview with --config");
      } else if (await ask("/gains", this.changed())) {
        // What arrives has them once mien has read them.
        this.reset();
      }
    });
    byId("gains-reset").addEventListener("click", () => this.reset());
  }

  reset() {
    this.of.clear();
    for (const row of document.querySelectorAll(".gain")) {
      row.querySelector("input").value = 1;
      row.querySelector("output").textContent = "×1.0";
    }
  }

  changed() {
    return [...this.of].filter(([, gain]) => gain !== 1);
  }

  toml() {
    const lines = this.changed().map(([unit, gain]) => `${unit} = { gain = ${gain} }\n`);
    return ["# Gains tried in mien-studio preview.\n[units]\n", ...lines].join("");
  }

  row(unit, parent) {
    const row = element("label", parent, { className: "gain" });
    element("span", row, { textContent: "gain" });
    const slider = element("input", row, { type: "range", min: 0, max: 2, step: 0.1, value: this.of.get(unit) ?? 1 });
    const output = element("output", row, { textContent: `×${Number(slider.value).toFixed(1)}` });
    row.addEventListener("click", (event) => event.stopPropagation());
    slider.addEventListener("input", () => {
      this.of.set(unit, Number(slider.value));
      output.textContent = `×${Number(slider.value).toFixed(1)}`;
    });
  }
}

export class Receivers {
  constructor(words, stream) {
    this.stream = stream;
    this.told = null;
    const choice = byId("receiver-id");
    for (const { id, name } of words.receivers) element("option", choice, { value: id, textContent: name });
    this.known = new Map(words.receivers.map((known) => [known.id, known]));
    const changed = () => this.lines();
    choice.addEventListener("change", () => this.choose());
    byId("receiver-host").addEventListener("input", changed);
    byId("receiver-port").addEventListener("input", changed);
    byId("receiver").addEventListener("submit", (event) => {
      event.preventDefault();
      this.ask(choice.value, "connect");
    });
    byId("receiver-test").addEventListener("click", () => this.ask(choice.value, "test"));
    byId("lines-copy").addEventListener("click", async () => {
      try {
        await navigator.clipboard.writeText(byId("lines").textContent);
        say("copied");
      } catch {
        getSelection().selectAllChildren(byId("lines"));
        say("the browser does not allow copying from the page; the lines are selected, press Ctrl-C");
      }
    });
    this.choose();
  }

  choose() {
    const { port, hint } = this.known.get(byId("receiver-id").value);
    byId("receiver-port").value = port;
    byId("receiver-hint").textContent = hint;
    this.lines();
  }

  lines() {
    const { section, more } = this.known.get(byId("receiver-id").value);
    const target = `${byId("receiver-host").value.trim()}:${byId("receiver-port").value.trim()}`;
    byId("lines").textContent = `[${section}]\nenabled = true\ntarget = "${target}"\n${more}`;
  }

  ask(id, wish, target) {
    const [host, port] = target ?? [byId("receiver-host").value.trim(), byId("receiver-port").value.trim()];
    return ask("/receiver", { id, do: wish, host, port });
  }

  draw() {
    const told = this.stream.receivers;
    byId("receiver-connect").disabled = Boolean(this.stream.source?.session);
    byId("receiver-connect").title = this.stream.source?.session ? "to send a recording, use mien run --source" : "";
    if (told === this.told) return;
    this.told = told;
    // Lines stay while their receivers do: a button that is being pressed must not be made anew with every count.
    const lines = new Map([...byId("connected").children].map((line) => [line.dataset.of, line]));
    const shown = Object.entries(told).map(([id, { target, sent, connected, testing, why }]) => {
      const of = `${id} ${target}`;
      const line = lines.get(of) ?? this.line(of, id, target);
      const name = this.known.get(id)?.name ?? id;
      const doing = why || (testing ? "testing" : connected ? "sending" : "tested");
      line.firstChild.textContent = `${name} · ${target}: ${doing}, ${sent} packets`;
      return line;
    });
    if (shown.length !== lines.size || shown.some((line) => !line.isConnected)) byId("connected").replaceChildren(...shown);
  }

  line(of, id, target) {
    const line = document.createElement("div");
    line.className = "line";
    line.dataset.of = of;
    element("span", line);
    const at = target.lastIndexOf(":");
    const stop = element("button", line, { textContent: "Stop" });
    stop.addEventListener("click", () => this.ask(id, "stop", [target.slice(0, at).replace(/[[\]]/g, ""), target.slice(at + 1)]));
    return line;
  }
}

// Rows of units as every page shows them: order, names, scale, and a colour that is a unit's own. No imports: pages that are one
// file have this text in their script.

export const STATES = ["absent", "warming", "tracking", "held", "lost", "posed"];
// What learning is called that goes on, has stopped, and is to go on.
export const FREEZE = { wish: "Freeze", state: "frozen", end: "Resume" };

// Codes in the order that gives neighbours of a region hues far apart; others get one from their letters.
const CODES = [1, 2, 4, 5, 6, 9, 10, 12, 14, 15, 17, 18, 20, 22, 25, 26, 28, 29, 30, 34, 43, 61, 62, 63, 64];

export function hue(unit) {
  const at = CODES.indexOf(Number(/^AU(\d+)/.exec(unit)?.[1]));
  return ((at < 0 ? [...unit].reduce((sum, c) => 31 * sum + c.charCodeAt(0), 7) : at) * 137.5) % 360;
}

// The subject's right is dotted, in the colour of the left.
export const isRight = (unit) => /^AU\d+R$/.test(unit);

// A weight: .00 to 1, above that exaggerated.
export function scaled(weight) {
  const text = weight.toFixed(2);
  return text === "1.00" ? "1" : text.replace(/^0/, "");
}

export function element(kind, parent, className = "", text = "") {
  const made = parent.appendChild(document.createElement(kind));
  if (className) made.className = className;
  made.textContent = text;
  return made;
}

// Below this share of a region that can be seen, its units are covered: their weights are at rest whatever the face does.
const SEEN = 0.5;

// One row per unit under the names of the regions: `regions` is [[title, [[index, unit, name, about, [what it needs to be seen]], …]], …].
export class Rows {
  constructor(parent, regions) {
    parent.replaceChildren();
    this.sections = regions.map(([title, rows]) => {
      const section = element("section", parent);
      const note = element("span", element("h3", section, "region", `${title} `), "note");
      return { note, rows: rows.map((row) => this.row(section, row)) };
    });
    this.all = this.sections.flatMap(({ rows }) => rows);
  }

  row(parent, [k, unit, plain, about, needs]) {
    const row = element("div", parent, "unit");
    row.dataset.unit = unit;
    row.title = about;
    const name = element("span", row, "name", plain);
    if (plain !== unit) element("small", name, "", unit);
    const scale = element("div", row, "scale");
    const bar = element("div", scale, "bar");
    bar.dataset.unit = unit;
    return { unit, k, plain, about, needs, row, name, scale, bar, fill: element("i", bar), value: element("span", row, "value", ".00") };
  }

  // Weights in the order of the units; `seen` is how far regions can be seen, by name: wholly if not named.
  draw(weights, seen = {}) {
    for (const { note, rows } of this.sections) {
      const covered = rows.filter(({ row, needs }) => row.classList.toggle("covered", needs.some((region) => seen[region] < SEEN)));
      const text = covered.length === 0 ? "" : covered.length < rows.length ? "partly covered" : "covered";
      if (note.textContent !== text) note.textContent = text;
    }
    for (const { k, fill, bar, value } of this.all) {
      const weight = weights[k] ?? 0;
      fill.style.transform = `scaleX(${Math.min(1, weight)})`;
      bar.classList.toggle("over", weight > 1);
      bar.dataset.weight = weight;
      const text = scaled(weight);
      if (value.textContent !== text) value.textContent = text;
    }
  }
}

let audio = null;
export function beep() {
  audio ??= new AudioContext();
  const [tone, gain] = [audio.createOscillator(), audio.createGain()];
  tone.connect(gain).connect(audio.destination);
  gain.gain.value = 0.1;
  tone.start();
  tone.stop(audio.currentTime + 0.12);
}

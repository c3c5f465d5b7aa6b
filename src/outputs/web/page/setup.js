// Set-up of gestures on the box's page and in the preview: for each gesture a button to make the expression five times, a button to undo,
// fields for level and hold time, and the number of activations; below, the lines for the configuration. The keyboard reaches all controls
// in the order of the page; for one switch that sends Enter or Space the focus moves from button to button by itself. This file has no
// imports, because pages that consist of one file contain its text in their script.

const FIVE = 5;
const STEP_MS = 1500;

// The message for the state of a set-up.
function told({ state, seen, on, hold_s }) {
  switch (state) {
    case "rest": return "Look at the sensor with a relaxed face.";
    case "act": return `Make the expression for about ${duration(hold_s)}, then relax: ${seen} of ${FIVE}.`;
    case "found": return `Done: level ${on.toFixed(2)}, hold time ${hold_s.toFixed(2)} s.`;
    case "kept": return "Done: the present level already suits this person.";
    case "weak": return "Nothing was changed: speech and glances reach as far as these expressions. Make them more strongly, or choose another gesture.";
    case "failed": return "Nothing was changed: for a minute no expression was seen that clearly rises and returns. Sit 0.5 to 1 m from the sensor, face it, and make the expression clearly.";
    default: return "";
  }
}

// How long to hold the expression: longer than the hold time, which the set-up shortens if a person cannot hold it that long.
function duration(hold_s) {
  return hold_s <= 0.7 ? "a second" : `${Math.ceil(1.5 * hold_s)} seconds`;
}

// How often the gesture went on; the rate is per hour in which a face was tracked.
function often({ count, tracked_s }) {
  const hours = tracked_s / 3600;
  return `${count} activations in the last 24 hours` + (hours >= 0.1 ? `, ${(count / hours).toFixed(1)} per hour with a face` : "");
}

export class SetUps {
  // `send(name, index, number)` sends a command for a gesture; some need no number. `hear()` is called for each repetition.
  constructor(parent, send, hear) {
    [this.parent, this.send, this.hear, this.rows] = [parent, send, hear, new Map()];
    this.make("p", parent, "Press the button beside a gesture and follow the instructions. The person who is shown makes the expression five times.").className = "about";
    const label = this.make("label", parent, " One switch: the focus moves from button to button by itself");
    const scan = document.createElement("input");
    scan.type = "checkbox";
    scan.checked = location.hash === "#switch";
    if (scan.checked) parent.open = true;
    label.prepend(scan);
    this.list = this.make("div", parent);
    const lines = this.make("details", parent);
    this.make("summary", lines, "Lines for the configuration");
    this.lines = this.make("pre", lines);
    setInterval(() => scan.checked && this.step(), STEP_MS);
  }

  make(kind, parent, text = "") {
    const made = parent.appendChild(document.createElement(kind));
    made.textContent = text;
    return made;
  }

  field(parent, text, what, one) {
    const label = this.make("label", parent, `${text} `);
    const field = label.appendChild(document.createElement("input"));
    Object.assign(field, { type: "number", min: 0, step: 0.01 });
    field.addEventListener("change", () => field.value && this.send(what, one.index, Math.round(100 * field.value)));
    return field;
  }

  row(name) {
    const row = this.make("div", this.list);
    row.className = "setup";
    const plain = name.replaceAll("_", " ");
    this.make("h3", row, plain);
    const one = { name, plain, state: "none", seen: 0 };
    one.teach = this.make("button", row);
    one.teach.addEventListener("click", () => this.send("teach", one.index, one.teach.dataset.runs ? 0 : 1));
    one.undo = this.make("button", row, "Undo");
    one.undo.ariaLabel = `Undo the last change of ${plain}`;
    one.undo.addEventListener("click", () => this.send("undo", one.index));
    [one.level, one.hold] = [this.field(row, "level", "level", one), this.field(row, "hold time, s", "hold", one)];
    [one.level.ariaLabel, one.hold.ariaLabel] = [`level of ${plain}`, `hold time of ${plain}, seconds`];
    one.said = this.make("p", row);
    one.said.role = "status";
    one.often = this.make("p", row);
    one.often.className = "about";
    return one;
  }

  // Shows the facts of a gesture, as the box sends them.
  take(name, facts) {
    this.parent.hidden = false;
    if (!this.rows.has(name)) this.rows.set(name, this.row(name));
    const one = this.rows.get(name);
    const text = (element, words) => { if (element.textContent !== words) element.textContent = words; };
    const runs = ["rest", "act"].includes(facts.state);
    if (facts.seen > one.seen && facts.state !== "failed") this.hear();
    Object.assign(one, facts);
    one.teach.dataset.runs = runs ? 1 : "";
    text(one.teach, runs ? "Stop" : "Make it five times");
    one.teach.ariaLabel = `${one.teach.textContent}: ${one.plain}`;
    one.undo.disabled = !facts.can_undo;
    for (const [field, value] of [[one.level, facts.on], [one.hold, facts.hold_s]]) {
      if (document.activeElement !== field) field.value = value.toFixed(2);
    }
    text(one.said, told(facts));
    text(one.often, often(facts));
    const all = [...this.rows.values()].filter((row) => row.can_undo);
    text(this.lines, all.map((row) => `[[gesture]]\nname = "${row.name}"\non = ${row.on}\noff = ${row.off}\nhold_s = ${row.hold_s}\nrise_s = ${row.rise_s}\n`).join("") || "No level was changed.");
  }

  // Moves the focus to the next button; while a set-up runs, to its Stop button.
  step() {
    const buttons = [...this.list.querySelectorAll("button:not(:disabled)")];
    const running = buttons.find(({ dataset }) => dataset.runs);
    (running ?? buttons[(buttons.indexOf(document.activeElement) + 1) % buttons.length])?.focus();
  }
}

// The box's own page: who is there, their units, gestures, and neutral, freeze and forget. Behind units.js in one script.

const at = (id) => document.getElementById(id);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const cards = [];
let box, heard = 0;

async function order(what, done) {
  try {
    const { ok, status } = await fetch(what, { method: "POST", headers: { "X-Mien": "1" } });
    at("answer").textContent = ok ? done : `not done: the box answered ${status}`;
  } catch { at("answer").textContent = "not done: the box cannot be reached"; }
}

function button(parent, text, title, press) {
  const one = element("button", parent, "", text);
  one.title = title;
  one.onclick = press;
  return one;
}

function card(slot) {
  const article = element("article", at("users"), "card");
  const head = element("div", article, "row");
  const who = `Person ${slot + 1}`;
  element("h2", head, "plate", who);
  const state = element("span", head, "badge");
  const figures = element("span", head);
  const buttons = element("div", article, "buttons");
  button(buttons, "Set neutral", "take the current face as neutral", () => order(`neutral/${slot}`, `${who}: the current face is neutral`));
  const freeze = button(buttons, FREEZE.wish, "stop learning ranges, or resume it", () => {
    const on = freeze.ariaPressed !== "true";
    order(`freeze/${slot}/${on ? 1 : 0}`, `${who}: learning ${on ? "is frozen" : "resumed"}`);
  });
  button(buttons, "Forget", "discard what was learned about this person", () => confirm(`Forget what was learned about person ${slot + 1}?`) &&
    order(`forget/${slot}`, `${who}: forgotten`));
  return { article, state, figures, freeze, rows: new Rows(element("div", article, "regions"), box.regions) };
}

// Of each gesture: the sum of its units over the last seconds, its levels, and how often it went on.
const CURVE = 160;
const lamps = [];
const setUps = new SetUps(at("setups"), (...words) => order(words.join("/"), ""), () => at("sound").checked && beep());

function lamp(gesture, index) {
  const row = element("div", at("gestures"), "gesture");
  const most = Math.min(...gesture.sums.map((terms) => terms.filter(([, sign]) => sign > 0).length));
  const one = { ...gesture, most, curve: [], count: 0, is_on: false, light: element("span", row, "lamp") };
  element("span", row, "", gesture.name.replaceAll("_", " "));
  const canvas = element("canvas", row);
  one.number = element("span", row, "", "0");
  one.number.title = "how many times it went on since this page was opened";
  one.draw = () => {
    const [width, height] = [canvas.width = canvas.clientWidth, canvas.height = canvas.clientHeight];
    const pen = canvas.getContext("2d");
    const y = (level) => height * (1 - level / one.most);
    const line = (level, name) => { pen.fillStyle = colour(name); pen.fillRect(0, y(level), width, 2); };
    line(one.off, "--line");
    line(one.on, "--warn");
    pen.strokeStyle = colour("--accent");
    pen.lineWidth = 1.6;
    pen.beginPath();
    one.curve.forEach((sum, i) => pen.lineTo(width * (1 - (one.curve.length - i) / CURVE), y(Math.max(0, sum))));
    pen.stroke();
  };
  canvas.onpointerdown = canvas.onpointermove = (event) => {
    if (!event.buttons) return;
    canvas.setPointerCapture(event.pointerId);
    const on = one.most * (1 - event.offsetY / canvas.clientHeight);
    const level = Math.min(Math.max(on, 0.05), one.most);
    [one.off, one.on, one.is_dragged] = [one.off * level / one.on, level, true];
  };
  canvas.onpointerup = () => {
    one.is_dragged = false;
    order(`level/${index}/${Math.round(100 * one.on)}`, "");
  };
  return one;
}

function showGestures(seen) {
  const user = seen.find(({ weights }) => weights.length);
  lamps.forEach((one, i) => {
    const is_on = seen.some(({ gestures }) => gestures >> i & 1);
    if (is_on && !one.is_on) {
      one.number.textContent = one.count += 1;
      if (at("sound").checked) beep();
    }
    one.is_on = is_on;
    one.light.classList.toggle("on", is_on);
    const sum = (terms) => terms.reduce((sum, [unit, sign]) => sum + sign * user.weights[unit], 0);
    one.curve.push(user ? Math.min(...one.sums.map(sum)) : 0);
    if (one.curve.length > CURVE) one.curve.shift();
    one.draw();
  });
}

function tell(state, text) {
  at("sensor").dataset.state = state;
  at("sensor").textContent = text;
}

function show(news) {
  heard = Date.now();
  const seen = news.users.filter((user) => user.state !== "absent");
  const alive = news.silent_ms < 2000;
  tell(alive ? 2 : 4, alive ? `${news.rate.toFixed(0)} frames/s` : "no frames");
  at("people").textContent = !alive ? (news.frame ? `None for ${(news.silent_ms / 1000).toFixed(0)} s: is the sensor plugged in?` : "None yet: is the sensor plugged in?")
    : seen.length === 0 ? "Nobody is in front of the sensor." : seen.length === 1 ? "1 person" : `${seen.length} people`;
  for (const facts of news.set_ups) {
    const one = lamps[facts.index];
    if (!one) continue;
    setUps.take(one.name, facts);
    if (!one.is_dragged) [one.on, one.off] = [facts.on, facts.off];
  }
  showGestures(seen);
  cards.forEach((one, slot) => { one.article.hidden = !seen.some((user) => user.slot === slot); });
  for (const user of seen) {
    const one = cards[user.slot];
    one.state.dataset.state = STATES.indexOf(user.state);
    one.state.textContent = user.state + (user.frozen ? `, ${FREEZE.state}` : "");
    one.figures.textContent = `${(100 * user.confidence).toFixed(0)} % confidence` + (user.latency_us ? `, ${(user.latency_us / 1000).toFixed(0)} ms` : "");
    one.freeze.ariaPressed = user.frozen;
    one.freeze.textContent = user.frozen ? FREEZE.end : FREEZE.wish;
    one.rows.draw(user.weights, user.seen);
  }
}

async function start() {
  let text;
  try {
    text = await (await fetch("box.json")).text();
  } catch { return void setTimeout(start, 2000); }
  box = JSON.parse(text);
  document.title = at("name").textContent = box.name;
  at("sends").textContent = box.sends ? `Sends ${box.sends}` : "Sends nothing yet: enable an output in the configuration.";
  for (let slot = 0; slot < box.slots; slot += 1) {
    cards.push(card(slot));
    cards[slot].article.hidden = true;
  }
  at("gestures").hidden = box.gestures.length === 0;
  lamps.push(...box.gestures.map(lamp));
  const events = new EventSource("events");
  events.onmessage = ({ data }) => show(JSON.parse(data));
  // Before this connection the box may have read a configuration with other gestures.
  events.onopen = async () => {
    if (await (await fetch("box.json")).text() !== text) location.reload();
  };
  setInterval(() => {
    if (Date.now() - heard > 3000) {
      tell(4, "no reply");
      at("people").textContent = "The box does not answer; retrying …";
    }
  }, 1000);
}
start();

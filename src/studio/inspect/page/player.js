// Plays what `mien-studio inspect` read: pictures, depth and curves at one time. Behind units.js and drawing.js in one script.

const byId = (id) => document.getElementById(id);
const { frames, faces, key, colours, plots } = JSON.parse(byId("data").textContent);
const [first, last] = [Math.min(...plots.map(({ x }) => x[0])), Math.max(...plots.map(({ x }) => x.at(-1)))];
let now = first;
let playing = false;

// Index of the last of some times that is not after `t`, at least 0.
function before(count, time, t) {
  let [low, high] = [0, count];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (time(middle) <= t + 1e-6) low = middle + 1;
    else high = middle;
  }
  return Math.max(0, low - 1);
}

// A picture of the frame of now, decoded before it is shown.
class Screen {
  constructor(id) {
    [this.id, this.canvas, this.shown, this.busy] = [id, byId(id), null, false];
    this.canvas.parentElement.hidden = !frames.some((frame) => frame[id]);
  }

  async show(frame) {
    if (this.busy || !frame?.[this.id] || this.shown === frame) return;
    this.busy = true;
    const image = new Image();
    image.src = frame[this.id];
    await image.decode().catch(() => null);
    this.canvas.getContext("2d").drawImage(image, 0, 0, this.canvas.width, this.canvas.height);
    this.shown = frame;
    this.busy = false;
    draw();
  }
}
const screens = ["colour", "depth"].map((id) => new Screen(id));

// Faces of points, where there are no pictures.
const extent = (axis) => {
  let [low, high] = [Infinity, -Infinity];
  for (const [, , m] of faces) for (let k = axis; k < m.length; k += 2) [low, high] = [Math.min(low, m[k]), Math.max(high, m[k])];
  return [low, high];
};
const [wide, tall] = [extent(0), extent(1)];
function drawFaces() {
  const { canvas } = screens[0];
  const pen = canvas.getContext("2d");
  const scale = 0.86 * Math.min(canvas.width / (wide[1] - wide[0] || 1), canvas.height / (tall[1] - tall[0] || 1));
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.strokeStyle = getComputedStyle(canvas).getPropertyValue("--accent").trim();
  pen.lineWidth = 2;
  const at = before(faces.length, (k) => faces[k][0], now);
  const seen = new Set();
  for (let k = at; k >= 0 && now - faces[k][0] < 0.5; k--) {
    const [, user, m] = faces[k];
    if (seen.has(user)) continue;
    seen.add(user);
    drawFace(pen, m.map((v, i) => (v - (i % 2 ? tall[0] + tall[1] : wide[0] + wide[1]) / 2) * scale + (i % 2 ? canvas.height : canvas.width) / 2));
  }
}

// A plot on the time line: its curves, a line where the page is, and the values there.
class Chart {
  constructor(plot) {
    this.plot = plot;
    const chart = element("section", byId("curves"), "chart");
    element("h3", chart, "", plot.title);
    this.legend = element("ul", chart, "legend");
    const frame = element("div", chart, "frame");
    this.canvas = element("canvas", frame);
    this.canvas.ariaLabel = plot.title;
    this.cursor = element("div", frame, "cursor");
    this.curves = plot.curves.map(({ name, unit, values }, k) => ({
      hue: unit ? hue(unit) : (k * 137.5 + 210) % 360,
      dotted: unit !== null && isRight(unit),
      label: unit ? name[0].toUpperCase() + name.slice(1) : name.replace(/^m_/, ""),
      unit, values,
      points: values.map((value, i) => (value === null ? null : [plot.x[i], value])),
    }));
    const all = plot.curves.flatMap(({ values }) => values).filter((value) => value !== null).concat(plot.least ?? []);
    const [low, high] = all.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
    const room = 0.04 * (high - low) || 0.5;
    [this.low, this.high] = low > high ? [0, 1] : [low - (low === 0 ? 0 : room), high + room];
    const seekTo = (event) => seek(first + timeAt(this.canvas, event.clientX) * (last - first));
    frame.addEventListener("pointerdown", (event) => {
      frame.setPointerCapture(event.pointerId);
      pause();
      seekTo(event);
    });
    frame.addEventListener("pointermove", (event) => { if (event.buttons) seekTo(event); });
  }

  draw() {
    drawLegend(this.legend, this.curves);
    drawCurves(this.canvas, { from: first, to: last, origin: first, low: this.low, high: this.high, curves: this.curves, name: (t) => `${(t - first).toFixed(last - first < 10 ? 1 : 0)} s` });
  }

  move() {
    this.cursor.style.left = placeOf((now - first) / (last - first || 1));
    const { x } = this.plot;
    const at = before(x.length, (k) => x[k], now);
    const text = (curve) => {
      const value = curve.values[at];
      return value === null ? "–" : curve.unit ? scaled(value) : value.toFixed(Math.abs(value) < 10 ? 2 : 0);
    };
    for (const curve of this.curves) curve.value = text(curve);
    drawLegend(this.legend, this.curves);
  }
}

const charts = plots.map((plot) => new Chart(plot));
function draw() {
  const frame = frames[before(frames.length, (k) => frames[k].t, now)];
  for (const screen of screens) screen.show(frame);
  if (!frames.length && faces.length) drawFaces();
  for (const chart of charts) chart.move();
  byId("scrub").value = (now - first) / (last - first || 1);
  byId("clock").textContent = `${(now - first).toFixed(1)} of ${(last - first).toFixed(1)} s`;
}

function seek(time) {
  now = Math.min(last, Math.max(first, time));
  draw();
}

function pause() {
  playing = false;
  byId("play").textContent = "Play";
}

function play() {
  if (now >= last) now = first;
  playing = true;
  byId("play").textContent = "Pause";
  let then = performance.now();
  const pass = (at) => {
    if (!playing) return;
    seek(now + (at - then) / 1000);
    then = at;
    if (now >= last) pause();
    else requestAnimationFrame(pass);
  };
  requestAnimationFrame(pass);
}

// A frame back or on; of a table a row.
function stepBy(by) {
  const times = frames.length ? frames.map(({ t }) => t) : plots[0].x;
  const at = before(times.length, (k) => times[k], now);
  pause();
  seek(times[Math.min(times.length - 1, Math.max(0, at + by))]);
}

byId("play").addEventListener("click", () => (playing ? pause() : play()));
byId("scrub").addEventListener("input", ({ target }) => {
  pause();
  seek(first + target.value * (last - first));
});
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "INPUT") return;
  const does = { ArrowLeft: () => stepBy(-1), ArrowRight: () => stepBy(1), Home: () => seek(first), End: () => seek(last), " ": () => byId("play").click() }[event.key];
  if (!does || (event.key === " " && event.target.tagName === "BUTTON")) return;
  event.preventDefault();
  does();
});
const redraw = () => { for (const chart of charts) chart.draw(); };
addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);

if (!frames.length && faces.length) {
  screens[0].canvas.parentElement.hidden = false;
  screens[0].canvas.nextElementSibling.textContent = "Landmarks";
}
if (key) {
  const bar = element("i", byId("key"));
  bar.style.background = `linear-gradient(to right, ${colours.join()})`;
  for (const metres of key) element("span", byId("key"), "", `${metres.toFixed(2)} m`);
}
const every = Math.max(...plots.map((plot) => plot.every));
byId("about").textContent = [
  "Space plays and pauses, arrow keys step, dragging in a curve scrubs.",
  every > 1 ? `The curves show one value for every ${every} rows: the one farthest from their mean.` : "",
].join(" ");
redraw();
draw();

// For tests and the console.
window.mien = { frames, charts, screens, seek, get now() { return now - first; }, get playing() { return playing; } };

// Curves over time and faces of 68 points, as the live page and the player of `mien-studio inspect` draw them. No imports, as
// units.js.

// A step of 1, 2 or 5 times a power of ten that is at least `least`.
function step(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((k) => k * power >= least * 0.999);
}

const short = (value) => String(Number(value.toFixed(3)));

// Of the canvas, what is left of the curves and right of them, in pixels.
const [LEFT, RIGHT] = [38, 12];

// Draws `curves`, each `{ hue, dotted, points }` with points `[t, value]` in order of time and null for a gap, from time `from` to
// `to`; `name` says what is written at a time on the axis, of which one is `origin`.
export function drawCurves(canvas, { from, to, origin, low, high, curves, name }) {
  const scale = window.devicePixelRatio || 1;
  const style = getComputedStyle(canvas);
  const [faint, dim, light] = ["--line", "--dim", "--curve"].map((one) => style.getPropertyValue(one).trim());
  const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, width, height);
  pen.font = `${11 * scale}px system-ui, sans-serif`;
  const [left, right, top, bottom] = [LEFT * scale, width - RIGHT * scale, 6 * scale, height - 18 * scale];
  const x = (t) => left + ((t - from) / (to - from || 1)) * (right - left);
  const y = (w) => bottom - ((w - low) / (high - low || 1)) * (bottom - top);
  const line = (x0, y0, x1, y1, colour) => {
    pen.strokeStyle = colour;
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
    pen.stroke();
  };
  pen.lineWidth = scale;
  pen.fillStyle = dim;
  pen.textAlign = "right";
  const up = step(((high - low) / (bottom - top)) * 28 * scale);
  for (let w = Math.ceil(low / up - 1e-6) * up; w <= high + 1e-9; w += up) {
    line(left, y(w), right, y(w), faint);
    pen.fillText(short(w), left - 6 * scale, y(w) + 4 * scale);
  }
  pen.textAlign = "center";
  const along = step(((to - from) / (right - left)) * 70 * scale || 1);
  for (let k = Math.ceil((from - origin) / along - 1e-6); origin + k * along <= to + 1e-9; k++) {
    pen.fillText(name(origin + k * along), Math.min(x(origin + k * along), right - 8 * scale), height - 4 * scale);
  }
  pen.save();
  pen.beginPath();
  pen.rect(left, 0, right - left, height);
  pen.clip();
  pen.lineWidth = 1.6 * scale;
  for (const { hue, dotted, points } of curves) {
    pen.strokeStyle = `oklch(${light} .14 ${hue})`;
    pen.setLineDash(dotted ? [2 * scale, 2.5 * scale] : []);
    pen.beginPath();
    let drawn = false;
    for (const point of points) {
      if (point) pen[drawn ? "lineTo" : "moveTo"](x(point[0]), y(point[1]));
      drawn = point !== null;
    }
    pen.stroke();
  }
  pen.restore();
}

// Which time a place on the canvas is, from 0 to 1 of what is drawn.
export function timeAt(canvas, clientX) {
  const box = canvas.getBoundingClientRect();
  return Math.min(1, Math.max(0, (clientX - box.left - LEFT) / (box.width - LEFT - RIGHT)));
}

// Where that is again, as a CSS length.
export const placeOf = (share) => `calc(${LEFT}px + ${share.toFixed(5)} * (100% - ${LEFT + RIGHT}px))`;

// Lines between the 68 points: jaw, brows, nose, eyes, lips; [first, last, closed].
const RUNS = [[0, 16, 0], [17, 21, 0], [22, 26, 0], [27, 30, 0], [31, 35, 0], [36, 41, 1], [42, 47, 1], [48, 59, 1], [60, 67, 1]];

// The face of points x, y, x, y, ….
export function drawFace(pen, m) {
  pen.beginPath();
  for (const [first, last, closed] of RUNS) {
    for (let k = first; k <= last; k++) pen[k === first ? "moveTo" : "lineTo"](m[2 * k], m[2 * k + 1]);
    if (closed) pen.closePath();
  }
  pen.stroke();
}

// What the colours mean, in letters of the page's own colour: `curves` with a `label`.
export function drawLegend(list, curves) {
  const key = curves.map(({ label }) => label).join("|");
  if (list.dataset.key !== key) {
    list.dataset.key = key;
    list.replaceChildren(...curves.map(({ hue, dotted, label }) => {
      const item = document.createElement("li");
      const mark = item.appendChild(document.createElement("i"));
      mark.className = dotted ? "right" : "";
      mark.style.setProperty("--hue", hue);
      item.append(label, " ", document.createElement("output"));
      return item;
    }));
  }
  curves.forEach(({ value }, k) => {
    const output = list.children[k].lastChild;
    if (value !== undefined && output.textContent !== value) output.textContent = value;
  });
}

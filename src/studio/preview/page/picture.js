// The sensor's picture with the landmarks, where this computer has it; landmarks alone from a table that has them. Without
// colour it is the depth camera's picture with the heads' boxes.

import { STATES } from "./stream.js";

// Lines between the 68 points: jaw, brows, nose, eyes, lips; [first, last, closed].
const RUNS = [[0, 16, 0], [17, 21, 0], [22, 26, 0], [27, 30, 0], [31, 35, 0], [36, 41, 1], [42, 47, 1], [48, 59, 1], [60, 67, 1]];
const [WIDTH, HEIGHT] = [640, 480];
const LEAST_MS = 60;
// By state.
const COLOURS = ["#ffffff", "#ffdc00", "#3cff3c", "#ff9628", "#ff3c3c", "#ff5aff"];

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    [canvas.width, canvas.height] = [WIDTH, HEIGHT];
    this.bitmap = null;
    this.frame = null;
    this.depth = false;
    this.asking = false;
    this.asked = 0;
  }

  // One question at a time; the answer says which frame it is.
  async ask(number) {
    if (this.asking || performance.now() - this.asked < LEAST_MS || number === this.frame) return;
    this.asking = true;
    this.asked = performance.now();
    try {
      const answer = await fetch(`/picture?n=${number}`);
      if (answer.ok) {
        this.bitmap = await createImageBitmap(await answer.blob());
        this.frame = Number(answer.headers.get("X-Frame"));
        this.depth = answer.headers.get("X-View") === "depth";
      }
    } catch {
      // The state line says that the connection is gone.
    }
    this.asking = false;
  }

  // `shown` are the samples of now; `unpeopled` is the number of the frame if there are none, if known; `find` gives a user's
  // sample of a frame.
  draw(pictures, shown, unpeopled, find) {
    const points = shown.some((sample) => sample.m || sample.b);
    this.canvas.hidden = !(pictures ? this.bitmap || shown.length : points);
    if (this.canvas.hidden && !pictures) return;
    const number = shown[0]?.n ?? unpeopled;
    if (pictures && number !== undefined) this.ask(number);
    const ink = this.canvas.getContext("2d");
    if (this.bitmap) ink.drawImage(this.bitmap, 0, 0, WIDTH, HEIGHT);
    else ink.clearRect(0, 0, WIDTH, HEIGHT);
    ink.lineWidth = 2;
    ink.font = "20px system-ui, sans-serif";
    for (const sample of shown) {
      // Points of the frame that is seen, not of a later one.
      const { m, b, s } = (this.bitmap ? find(sample.u, this.frame) : sample) ?? {};
      // Boxes are of the depth camera, points of the colour camera.
      if (b && (this.bitmap ? this.depth : !m)) {
        const [x0, y0, x1, y1] = b;
        ink.strokeStyle = ink.fillStyle = COLOURS[s];
        ink.strokeRect(x0, y0, x1 - x0, y1 - y0);
        ink.fillText(`person ${sample.u + 1} ${STATES[s]}`, x0, y0 < 24 ? y1 + 22 : y0 - 6);
      }
      if (!m || (this.bitmap && this.depth)) continue;
      ink.strokeStyle = "#00beff";
      ink.beginPath();
      for (const [first, last, closed] of RUNS) {
        for (let k = first; k <= last; k++) ink[k === first ? "moveTo" : "lineTo"](m[2 * k], m[2 * k + 1]);
        if (closed) ink.closePath();
      }
      ink.stroke();
    }
  }
}

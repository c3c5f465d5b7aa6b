// What the sensor sees, where this computer has it: its picture with the landmarks, and its depth with the heads' boxes. From a
// table that has them, landmarks alone.

import { drawFace } from "./drawing.js";
import { STATES } from "./units.js";

const [WIDTH, HEIGHT] = [640, 480];
const LEAST_MS = 60;
// By state.
const COLOURS = ["#ffffff", "#ffdc00", "#3cff3c", "#ff9628", "#ff7a7a", "#ff9dff"];

export class Picture {
  // `view`: colour or depth.
  constructor(canvas, view) {
    [this.canvas, this.view] = [canvas, view];
    [canvas.width, canvas.height] = [WIDTH, HEIGHT];
    this.bitmap = null;
    this.frame = null;
    this.asked = { number: null, at: 0, busy: false };
  }

  get hidden() { return this.canvas.parentElement.hidden; }

  // One question at a time; the answer says which frame it is, and of which camera.
  async ask(number) {
    const { asked } = this;
    if (asked.busy || performance.now() - asked.at < LEAST_MS || number === asked.number) return;
    Object.assign(asked, { busy: true, at: performance.now() });
    try {
      const answer = await fetch(`/picture?n=${number}${this.view === "depth" ? "&view=depth" : ""}`);
      if (answer.ok) {
        const frame = Number(answer.headers.get("X-Frame"));
        // The newest is asked for again and again.
        asked.number = number < 0 ? null : number;
        // A sensor without colour shows its depth once.
        if (answer.headers.get("X-View") === this.view) [this.bitmap, this.frame] = [await createImageBitmap(await answer.blob()), frame];
      }
    } catch {
      // The state line says that the connection is gone.
    }
    asked.busy = false;
  }

  // `shown` are the samples of now; `unpeopled` is the number of the frame if there are none, if known; `find` gives a user's
  // sample of a frame.
  draw(pictures, shown, unpeopled, find) {
    const number = shown[0]?.n ?? unpeopled;
    if (pictures && number !== undefined) this.ask(number);
    const points = !pictures && this.view === "colour" && shown.some((sample) => sample.m || sample.b);
    this.canvas.parentElement.hidden = !(this.bitmap || points);
    if (this.hidden) return;
    const pen = this.canvas.getContext("2d");
    if (this.bitmap) pen.drawImage(this.bitmap, 0, 0, WIDTH, HEIGHT);
    else pen.clearRect(0, 0, WIDTH, HEIGHT);
    pen.lineWidth = 2;
    const plates = [];
    for (const sample of shown) {
      // Points of the frame that is seen, not of a later one.
      const { m, b, s } = (this.bitmap ? find(sample.u, this.frame) : sample) ?? {};
      // Boxes are of the depth camera, points of the colour camera.
      if (b && (this.view === "depth" || (!this.bitmap && !m))) {
        const [x0, y0, x1, y1] = b;
        pen.strokeStyle = COLOURS[s];
        pen.strokeRect(x0, y0, x1 - x0, y1 - y0);
        plates.push([x0, y0, `Person ${sample.u + 1} ${STATES[s]}`, COLOURS[s]]);
      }
      if (!m || this.view === "depth") continue;
      pen.strokeStyle = "#00beff";
      drawFace(pen, m);
      const brow = Math.min(...m.slice(34, 54).filter((_, k) => k % 2));
      if (shown.length > 1) plates.push([m[0], brow - 24, `Person ${sample.u + 1}`, "#ffffff"]);
    }
    for (const plate of plates) this.plate(pen, ...plate);
  }

  // Words on a dark plate above a place, within the picture.
  plate(pen, x, y, text, colour) {
    pen.font = "600 20px system-ui, sans-serif";
    const wide = pen.measureText(text).width + 16;
    const [left, top] = [Math.min(Math.max(x, 0), WIDTH - wide), Math.max(y - 32, 2)];
    pen.fillStyle = "#000c";
    pen.beginPath();
    pen.roundRect(left, top, wide, 28, 6);
    pen.fill();
    pen.fillStyle = colour;
    pen.fillText(text, left + 8, top + 21);
  }
}

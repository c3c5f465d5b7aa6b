// Remakes tests/data/following.webp, the README's moving picture: our head driven by the weights, and the face in the simulated sensor's
// picture with the landmarks found in it. Needs what tests/preview/run has installed, and ffmpeg.
//
//   NODE_PATH=target/preview/node_modules node tests/preview/following.cjs FOLDER OUT.webp [SHEET.png]
//
// FOLDER is where mien-studio is; SHEET.png gets every eighth frame, to be looked at.
const { chromium } = require("playwright-core");
const { spawn, execFileSync } = require("node:child_process");
const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");

const [programs, out, sheet] = process.argv.slice(2);
const studio = path.join(programs, "mien-studio");
const work = fs.mkdtempSync(path.join(os.tmpdir(), "mien-following-"));
// Surprise, then joy, in the second turn of the moods, when the ranges are known.
const [FROM, SECONDS, RATE, RECORDED] = [21.1, 6, 12.5, 28];
// Widths of the head and of the sensor's picture beside it, and the height of both, pixels.
const [HEAD, WIDE, TALL] = [320, 240, 320];
// The face fills this share of the picture's height, and begins this share below its upper edge.
const [FILLS, BELOW] = [0.8, 0.12];
const LINES = [[0, 17], [17, 22], [22, 27], [27, 31], [31, 36], [36, 42, true], [42, 48, true], [48, 60, true], [60, 68, true]];

(async () => {
  execFileSync(studio, ["record", "--source", "simulated:moods", "--seconds", String(RECORDED), "--out", path.join(work, "moods")]);
  const preview = spawn(studio, ["preview", "--source", path.join(work, "moods"), "--port", "0"]);
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM || execFileSync("sh", ["-c", "command -v chromium"]).toString().trim(),
    args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
  try {
    const url = await new Promise((resolve) => preview.stdout.on("data", (data) => resolve(/open (\S+)/.exec(data)[1])));
    const page = await browser.newPage({ viewport: { width: 1000, height: 700 }, colorScheme: "dark" });
    page.setDefaultTimeout(400000);
    await page.goto(url);
    await page.waitForFunction((until) => window.mien.heads.length === 1 && window.mien.stream.last > until, RECORDED - 0.2);
    await page.click("#play");
    // The head has its pictures.
    await page.waitForFunction(() => window.mien.heads[0].parts.filter((part) => part.texture).length >= 2);
    const start = await page.evaluate(({ FROM, SECONDS, HEAD, WIDE, TALL, FILLS, BELOW, LINES }) => {
      const { stream, view } = window.mien;
      // The page's own drawing rests from here on.
      window.requestAnimationFrame = () => 0;
      const at = (time) => {
        stream.seek(time);
        return stream.at(0);
      };
      // One cut for all frames, so that the picture stands still.
      const all = [];
      for (let t = 0; t < SECONDS; t += 0.2) {
        const m = at(FROM + t)?.m;
        if (m?.length) all.push(...m);
      }
      const axis = (k) => all.filter((_, i) => i % 2 === k);
      const [across, down] = [0, 1].map((k) => axis(k).reduce((a, b) => Math.min(a, b), Infinity)).map((l, k) => [l, axis(k).reduce((a, b) => Math.max(a, b), -Infinity)]);
      const tall = (down[1] - down[0]) / FILLS;
      const scale = TALL / tall;
      const canvas = view.canvas;
      Object.defineProperty(canvas, "clientWidth", { value: 2 * HEAD });
      Object.defineProperty(canvas, "clientHeight", { value: 2 * TALL });
      const sheet = new OffscreenCanvas(HEAD + WIDE, TALL);
      const ink = sheet.getContext("2d", { willReadFrequently: true });
      ink.imageSmoothingQuality = "high";
      window.shoot = async (time) => {
        const s = at(time);
        const answer = await fetch(`/picture?n=${s.n}`);
        const picture = await createImageBitmap(await answer.blob());
        ink.fillStyle = "#14171b";
        ink.fillRect(0, 0, HEAD + WIDE, TALL);
        const [left, top] = [(across[0] + across[1] - WIDE / scale) / 2, down[0] - BELOW * tall];
        ink.drawImage(picture, left, top, WIDE / scale, tall, HEAD, 0, WIDE, TALL);
        ink.strokeStyle = "#1fb4f5";
        ink.lineWidth = 2;
        ink.lineJoin = "round";
        for (const [from, to, closed] of LINES) {
          ink.beginPath();
          for (let k = from; k < to; k++) ink.lineTo(HEAD + (s.m[2 * k] - left) * scale, (s.m[2 * k + 1] - top) * scale);
          if (closed) ink.closePath();
          ink.stroke();
        }
        [view.yaw, view.pitch, view.distance] = [0, 0, 1.02];
        view.draw([{ head: view.heads[0], weights: new Map(stream.units.map((unit, k) => [unit, s.w[k] ?? 0])), pose: s.p }]);
        ink.drawImage(canvas, 0, 0, canvas.width, canvas.height, 0, 0, HEAD, TALL);
        const { data } = ink.getImageData(0, 0, HEAD + WIDE, TALL);
        let text = "";
        for (let k = 0; k < data.length; k += 8192) text += String.fromCharCode(...data.subarray(k, k + 8192));
        return btoa(text);
      };
      return { first: stream.first };
    }, { FROM, SECONDS, HEAD, WIDE, TALL, FILLS, BELOW, LINES });
    // The first drawing fits the canvas and asks for what is shown first only now.
    await page.evaluate((time) => window.shoot(time), start.first + FROM);
    await page.waitForTimeout(5000);
    const frames = [];
    for (let k = 0; k < SECONDS * RATE; k++) {
      const text = await page.evaluate((time) => window.shoot(time), start.first + FROM + k / RATE);
      frames.push(Buffer.from(text, "base64"));
    }
    const raw = ["-f", "rawvideo", "-pix_fmt", "rgba", "-s", `${HEAD + WIDE}x${TALL}`, "-r", String(RATE), "-i", "-"];
    const encode = (...to) => execFileSync("ffmpeg", ["-loglevel", "error", "-y", ...raw, ...to], { input: Buffer.concat(frames) });
    // Every frame whole: libwebp_anim keeps blocks of earlier ones, which show as ghosts.
    encode("-pix_fmt", "yuv420p", "-c:v", "libwebp", "-quality", "70", "-compression_level", "6", "-loop", "0", out);
    console.log(`${out}: ${frames.length} frames, ${fs.statSync(out).size} bytes`);
    if (sheet) encode("-vf", "select=not(mod(n\\,8)),tile=2x5", "-update", "1", sheet);
  } finally {
    await browser.close();
    preview.kill();
    fs.rmSync(work, { recursive: true, force: true });
  }
})();

// Remakes tests/data/moods.png: one acted stream, joy, sorrow, anger and surprise, drives two heads at once. Needs what
// tests/preview/run has installed.
//
//   NODE_PATH=target/preview/node_modules node tests/preview/moods.cjs FOLDER HEAD.glb OTHER.glb OUT.png
//
// FOLDER is where mien-studio is. Columns are the moods; rows the sensor's picture with its landmarks, and the heads.
const { chromium } = require("playwright-core");
const { spawn, execFileSync } = require("node:child_process");
const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");

const [programs, ...files] = process.argv.slice(2);
const [heads, out] = [files.slice(0, -1), files.at(-1)];
const studio = path.join(programs, "mien-studio");
const work = fs.mkdtempSync(path.join(os.tmpdir(), "mien-moods-"));
// Each mood lasts 3 s and is at its height in the middle; the second turn, when the ranges are known.
const TIMES = [13.6, 16.6, 19.6, 22.6];
const [WIDE, SENSOR, HEAD] = [190, 170, 215];

(async () => {
  execFileSync(studio, ["record", "--source", "simulated:moods", "--seconds", "25", "--out", path.join(work, "moods")]);
  const preview = spawn(studio, ["preview", "--source", path.join(work, "moods"), "--port", "0", ...heads.flatMap((head) => ["--mesh", head])]);
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM || execFileSync("sh", ["-c", "command -v chromium"]).toString().trim(),
    args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
  try {
    const url = await new Promise((resolve) => preview.stdout.on("data", (data) => resolve(/open (\S+)/.exec(data)[1])));
    const page = await browser.newPage({ viewport: { width: 390 + 3 * WIDE * heads.length, height: 3 * HEAD + 200 } });
    await page.goto(url);
    await page.waitForFunction((count) => window.mien.heads.length === count && window.mien.stream.last > 24.9, heads.length, { timeout: 240000 });
    await page.click("#play");
    await page.evaluate(() => { window.mien.view.distance = 0.78; });
    const picture = await page.evaluate(async ({ times, count, WIDE, SENSOR, HEAD }) => {
      const { stream } = window.mien;
      const all = new OffscreenCanvas(WIDE * times.length, SENSOR + HEAD * count);
      const ink = all.getContext("2d");
      ink.imageSmoothingQuality = "high";
      for (const [column, time] of times.entries()) {
        stream.seek(time);
        // The picture is asked for and drawn again.
        await new Promise((done) => setTimeout(done, 4000));
        const { m } = stream.at(0);
        const [xs, ys] = [0, 1].map((k) => m.filter((_, i) => i % 2 === k));
        const [x, y] = [(Math.min(...xs) + Math.max(...xs)) / 2, (Math.min(...ys) + Math.max(...ys)) / 2];
        const height = (Math.max(...ys) - Math.min(...ys)) * 1.75;
        const width = (height * WIDE) / SENSOR;
        ink.drawImage(document.getElementById("picture"), x - width / 2, y - height * 0.6, width, height, column * WIDE, 0, WIDE, SENSOR);
        const view = document.getElementById("view");
        const wide = view.width / count;
        for (let head = 0; head < count; head++) {
          // As much of each head as the tile's shape takes.
          const tall = Math.min(view.height, (wide * HEAD) / WIDE);
          const cut = (tall * WIDE) / HEAD;
          ink.drawImage(view, wide * (head + 0.5) - cut / 2, (view.height - tall) / 2, cut, tall, column * WIDE, SENSOR + head * HEAD, WIDE, HEAD);
        }
      }
      const bytes = new Uint8Array(await (await all.convertToBlob({ type: "image/png" })).arrayBuffer());
      return btoa(bytes.reduce((text, byte) => text + String.fromCharCode(byte), ""));
    }, { times: TIMES, count: heads.length, WIDE, SENSOR, HEAD });
    fs.writeFileSync(out, Buffer.from(picture, "base64"));
  } finally {
    await browser.close();
    preview.kill();
    fs.rmSync(work, { recursive: true, force: true });
  }
})();

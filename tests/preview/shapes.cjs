// Remakes tests/data/baked.png: the same shapes on any heads, one head a row. Needs what tests/preview/run has installed.
//
//   NODE_PATH=target/preview/node_modules node tests/preview/shapes.cjs FOLDER HEAD.glb... OUT.png
//
// FOLDER is where mien-studio is. Columns: blink, sneer, open jaw, funnel, smile, tongue.
const { chromium } = require("playwright-core");
const { spawn, execFileSync } = require("node:child_process");
const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");

const [programs, ...files] = process.argv.slice(2);
const [heads, out] = [files.slice(0, -1), files.at(-1)];
const SIDE = 200;
const SHAPES = [
  { eyeBlinkLeft: 1 }, { noseSneerLeft: 1, mouthUpperUpLeft: 0.8 }, { jawOpen: 1 },
  { mouthFunnel: 1 }, { mouthSmileLeft: 1 }, { jawOpen: 0.9, tongueOut: 1 },
];

(async () => {
  const work = fs.mkdtempSync(path.join(os.tmpdir(), "mien-shapes-"));
  const still = path.join(work, "still.csv");
  fs.writeFileSync(still, "frame,time_us,user,state,w_AU26\n0,0,0,tracking,0\n");
  const preview = spawn(path.join(programs, "mien-studio"), ["preview", "--csv", still, "--port", "0", ...heads.flatMap((head) => ["--mesh", head])]);
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM || execFileSync("sh", ["-c", "command -v chromium"]).toString().trim(),
    args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
  try {
    const url = await new Promise((resolve) => preview.stdout.on("data", (data) => resolve(/open (\S+)/.exec(data)[1])));
    const page = await browser.newPage({ viewport: { width: 1000, height: 700 } });
    await page.goto(url);
    await page.waitForFunction((count) => window.mien.heads.length === count, heads.length, { timeout: 120000 });
    await page.waitForTimeout(5000);
    const picture = await page.evaluate(async ({ SHAPES, SIDE }) => {
      const { view } = window.mien;
      window.requestAnimationFrame = () => 0;
      const canvas = view.canvas;
      for (const side of ["clientWidth", "clientHeight"]) Object.defineProperty(canvas, side, { value: 2 * SIDE });
      const all = new OffscreenCanvas(SIDE * SHAPES.length, SIDE * view.heads.length);
      const ink = all.getContext("2d");
      ink.imageSmoothingQuality = "high";
      view.heads.forEach((head, row) => SHAPES.forEach((shape, column) => {
        // By the shapes' own names, whatever units they have.
        const weights = new Map();
        for (const { name, unit } of head.targets) if (shape[name]) weights.set(unit ?? name, shape[name]);
        [view.yaw, view.pitch, view.distance] = [0.45, 0, 0.7];
        view.draw([{ head, weights, pose: null }]);
        ink.drawImage(canvas, 0, 0, canvas.width, canvas.height, column * SIDE, row * SIDE, SIDE, SIDE);
      }));
      const bytes = new Uint8Array(await (await all.convertToBlob({ type: "image/png" })).arrayBuffer());
      let text = "";
      for (const byte of bytes) text += String.fromCharCode(byte);
      return btoa(text);
    }, { SHAPES, SIDE });
    fs.writeFileSync(out, Buffer.from(picture, "base64"));
  } finally {
    await browser.close();
    preview.kill();
    fs.rmSync(work, { recursive: true, force: true });
  }
})();

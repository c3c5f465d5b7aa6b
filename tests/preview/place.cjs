// The page of `mien-studio place` in the browser of tests/preview/run: a point is dragged, its twin follows, the shapes are baked
// anew, undone, saved. Words: folder of the programs, folder for screenshots.
const { chromium } = require("playwright-core");
const { spawn, execFileSync } = require("node:child_process");
const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const { judge } = require("./layout.cjs");

const [programs, shots] = process.argv.slice(2);
const work = fs.mkdtempSync(path.join(os.tmpdir(), "mien-place-"));
let failures = 0;
let child = null;

function check(what, holds, found = "") {
  console.log(`${holds ? "ok  " : "FAIL"} ${what}${found === "" ? "" : `: ${found}`}`);
  if (!holds) failures += 1;
}

const seen = (k) => {
  const box = document.querySelector("#view").getBoundingClientRect();
  const [x, y] = window.mien.onScreen(window.mien.now.places[k]);
  return [x + box.left, y + box.top];
};

// Where a point is on the screen, once the view has come to rest.
async function atRest(page, point) {
  for (let before = await page.evaluate(seen, point); ;) {
    await page.waitForTimeout(500);
    const now = await page.evaluate(seen, point);
    if (Math.hypot(now[0] - before[0], now[1] - before[1]) < 0.1) return now;
    before = now;
  }
}

// A point by the keyboard alone: chosen, moved by a vertex and back where it was.
async function keys(page) {
  await page.selectOption("#look", "48-67");
  await page.waitForTimeout(1000);
  await page.evaluate(() => { document.activeElement.blur(); window.mien.choose(53); });
  await page.keyboard.press("n");
  check("N chooses the next point", /^54 /.test(await page.textContent("#which")), await page.textContent("#which"));
  const before = await page.evaluate(() => window.mien.now.points.slice());
  const [x, y] = await atRest(page, 54);
  await page.keyboard.press("ArrowUp");
  await page.waitForFunction((was) => window.mien.now.points[54] !== was, before[54]);
  const [p, q] = await atRest(page, 54);
  const after = await page.evaluate(() => window.mien.now.points.slice());
  const changed = before.map((v, k) => [v, k]).filter(([v, k]) => v !== after[k]).map(([, k]) => k);
  check("an arrow key moves the point and its twin up, by a vertex", y - q > 0.5 && y - q > Math.abs(p - x) && y - q < 40 && changed.join() === "48,54", `${(p - x).toFixed(1)}, ${(q - y).toFixed(1)} px; ${changed}`);
  await page.click("#undo");
  check("a step can be undone", (await page.evaluate(() => window.mien.now.points.join())) === before.join());
  await page.keyboard.press("p");
  check("P chooses the one before", /^53 /.test(await page.textContent("#which")));
}

(async () => {
  const mesh = path.join(work, "head.obj");
  const out = path.join(work, "head.landmarks.txt");
  execFileSync(path.join(programs, "mien-studio"), ["head", "--out", mesh]);
  child = spawn(path.join(programs, "mien-studio"), ["place", "--mesh", mesh, "--port", "0"], { stdio: ["ignore", "pipe", "inherit"] });
  const url = await new Promise((resolve, reject) => {
    child.stdout.on("data", (data) => resolve(/open (\S+)/.exec(data)?.[1]));
    child.on("exit", (code) => reject(new Error(`mien-studio place ended with ${code}`)));
  });
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM || execFileSync("sh", ["-c", "command -v chromium"]).toString().trim(),
    args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
  const page = await browser.newPage({ viewport: { width: 1600, height: 900 } });
  page.setDefaultTimeout(180000);
  const complaints = [];
  page.on("console", (message) => { if (["error", "warning"].includes(message.type())) complaints.push(message.text()); });
  page.on("pageerror", (error) => complaints.push(error.message));
  await page.goto(url);
  // What was guessed is not baked before somebody has said, of each point, that it is right.
  await page.waitForFunction(() => window.mien?.baked || (window.mien && document.querySelector("#first button")));
  const guessed = await page.evaluate(() => window.mien.unsure);
  check("guessed points are not baked", Boolean(guessed) !== (await page.evaluate(() => window.mien.baked)), `${guessed} unsure`);
  check("it says that nothing is saved", (await page.textContent("#state")) === "not saved yet" && !fs.existsSync(out));
  if (guessed) {
    await page.click("#bake");
    await page.waitForFunction(() => /^not baked: /.test(document.querySelector("#said").textContent));
    const said = await page.textContent("#said");
    check("Bake says why it waits", new RegExp(`${guessed} points? `).test(said), said);
    await page.keyboard.press("Escape");
    await page.click("#confirm");
    const left = await page.evaluate(() => window.mien.unsure);
    check("a point is confirmed, and no other", left === guessed - 1, `${left} of ${guessed}`);
    for (let k = 0; k < left; k++) await page.click("#confirm");
  }
  await page.waitForFunction(() => window.mien.baked);
  await keys(page);
  await judge(page, "place", { check, shots, panels: ["#scene", "#actions", ".bar-of-tab"] });
  await page.setViewportSize({ width: 1600, height: 900 });

  await page.selectOption("#look", "48-67");
  await page.waitForTimeout(1500);
  const before = await page.evaluate(() => window.mien.now.points.slice());
  const [x, y] = await page.evaluate(seen, 54);
  await page.mouse.move(x + 3, y + 2);
  await page.mouse.down();
  for (let k = 1; k <= 6; k++) await page.mouse.move(x + 3 + 7 * k, y + 2 - 4 * k);
  await page.waitForTimeout(300);
  await page.screenshot({ path: path.join(shots, "place-drag.png") });
  await page.mouse.up();
  await page.waitForFunction((was) => window.mien.now.points[54] !== was, before[54]);
  await page.waitForTimeout(1000);
  const after = await page.evaluate(() => window.mien.now);
  const changed = before.map((v, k) => [v, k]).filter(([v, k]) => v !== after.points[k]).map(([, k]) => k);
  check("the dragged point and its twin moved, and no other", changed.join() === "48,54", changed.join());
  const [p, q] = await page.evaluate(seen, 54);
  const off = Math.hypot(p - x - 42, q - y + 24);
  check("it lies where it was let go", off < 12, `${off.toFixed(1)} px off`);
  check("unsaved changes are said", (await page.textContent("#state")) === "unsaved changes" && await page.isVisible("#stale"));

  await page.click("#bake");
  await page.waitForFunction(() => window.mien.baked && document.querySelector("#stale").hidden);
  const none = await page.locator("#view").screenshot();
  await page.selectOption("#shape", "mouthSmileLeft");
  await page.waitForFunction(() => window.mien.head.targets[0]?.name === "mouthSmileLeft");
  await page.fill("#weight", "1");
  await page.waitForTimeout(1500);
  check("the shape is shown", !none.equals(await page.locator("#view").screenshot()));
  await page.screenshot({ path: path.join(shots, "place-shape.png") });
  await page.click("#undo");
  check("a drag can be undone", (await page.evaluate(() => window.mien.now.points.join())) === before.join());
  await page.click("#save");
  await page.waitForFunction(() => document.querySelector("#state").textContent === "saved");
  const lines = fs.readFileSync(out, "ascii").trim().split("\n");
  check("what is saved are the points shown", lines.length === 68 && lines.join() === before.join());
  check("the page complains of nothing", !complaints.some((text) => !/GPU stall|GL Driver Message/.test(text)), complaints.join(" | "));
  await browser.close();
})()
  .catch((error) => { console.log(`FAIL ${error.stack}`); failures += 1; })
  .finally(() => {
    child?.kill();
    fs.rmSync(work, { recursive: true, force: true });
    console.log(failures ? `${failures} failed` : "all well");
    process.exit(failures ? 1 : 0);
  });

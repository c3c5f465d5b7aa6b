// What tests/preview/run does in the browser. Words: folder of the programs, folder for screenshots and files.
const { chromium } = require("playwright-core");
const { spawn, execFileSync } = require("node:child_process");
const dgram = require("node:dgram");
const http = require("node:http");
const net = require("node:net");
const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const { layout, contrast, isEmpty, judge } = require("./layout.cjs");

const [programs, shots] = process.argv.slice(2);
const running = [];
const work = fs.mkdtempSync(path.join(os.tmpdir(), "mien-preview-"));
let failures = 0;

function check(what, holds, found = "") {
  console.log(`${holds ? "ok  " : "FAIL"} ${what}${found === "" ? "" : `: ${found}`}`);
  if (!holds) failures += 1;
}

function start(name, words, options = {}) {
  const child = spawn(path.join(programs, name), words, { stdio: ["pipe", "pipe", "inherit"], ...options });
  running.push(child);
  return child;
}

// Starts a preview on a free port; the address of its page.
function preview(words, stdin) {
  const child = start("mien-studio", ["preview", "--port", "0", ...words]);
  return new Promise((resolve, reject) => {
    let text = "";
    child.stdout.on("data", (data) => {
      text += data;
      const found = /open (\S+)/.exec(text);
      if (found) resolve({ child, url: found[1] });
    });
    child.on("exit", (code) => reject(new Error(`mien-studio preview ended with ${code}`)));
    if (stdin) child.stdin.end(stdin);
  });
}

const get = (url, headers = {}) => new Promise((resolve, reject) => {
  http.get(url, { headers, timeout: 5000 }, (answer) => {
    const parts = [];
    answer.on("data", (part) => parts.push(part));
    answer.on("end", () => resolve({ status: answer.statusCode, headers: answer.headers, body: Buffer.concat(parts) }));
  }).on("error", reject);
});

function freePort() {
  return new Promise((resolve) => {
    const socket = dgram.createSocket("udp4");
    socket.bind(0, "127.0.0.1", () => {
      const { port } = socket.address();
      socket.close(() => resolve(port));
    });
  });
}

// A page that notes every complaint.
async function noted(browser) {
  const page = await browser.newPage({ viewport: { width: 1280, height: 800 } });
  // Everything is drawn by the processor here, beside other work.
  page.setDefaultTimeout(180000);
  page.complaints = [];
  page.on("console", (message) => { if (["error", "warning"].includes(message.type())) page.complaints.push(message.text()); });
  page.on("pageerror", (error) => page.complaints.push(error.message));
  return page;
}

// One of the preview, that notes every answer too.
async function open(browser, url) {
  const page = await noted(browser);
  page.on("request", (request) => { if (!request.url().startsWith(url) && !request.url().startsWith("blob:")) page.complaints.push(`asks elsewhere: ${request.url()}`); });
  page.answers = [];
  page.on("response", (one) => page.answers.push(one));
  await page.goto(url);
  await page.waitForFunction(() => window.mien.heads.length > 0 && !window.mien.stream.empty);
  return page;
}

// Waits for what a busy machine may be minutes late with; the check that follows says whether it came.
const until = (page, condition, word) => page.waitForFunction(condition, word, { timeout: 120000 }).catch(() => null);

// Bytes that wait on a UDP port of this machine, as the kernel counts them.
function waiting(port) {
  const address = `:${port.toString(16).toUpperCase().padStart(4, "0")}`;
  const line = fs.readFileSync("/proc/net/udp", "ascii").split("\n").find((one) => one.trim().split(/\s+/)[1]?.endsWith(address));
  return line ? parseInt(line.trim().split(/\s+/)[4].split(":")[1], 16) : 0;
}

// Drivers of software rendering report how slow a read of pixels is; that is this test's, not the page's.
const complaints = (page) => page.complaints.filter((text) => !/GPU stall due to ReadPixels|GL Driver Message/.test(text));

const jaw = () => {
  const { stream, heads } = window.mien;
  const head = heads[0];
  const target = head.targets.findIndex(({ name }) => name === "jawOpen");
  const shown = stream.at(stream.present()[0] ?? 0);
  return { weight: head.weights[target], unit: shown?.w[stream.units.indexOf("AU26")] ?? 0 };
};

// Dark reddish pixels in the lower half of the middle of the view: the open mouth.
async function mouth(page) {
  const shot = await page.locator("#view").screenshot();
  return page.evaluate(async (base64) => {
    const bitmap = await createImageBitmap(new Blob([Uint8Array.from(atob(base64), (c) => c.charCodeAt(0))]));
    const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
    const ink = canvas.getContext("2d");
    ink.drawImage(bitmap, 0, 0);
    const [x, y, w, h] = [0.3, 0.5, 0.4, 0.4].map((share, k) => Math.round(share * (k % 2 ? bitmap.height : bitmap.width)));
    const { data } = ink.getImageData(x, y, w, h);
    let dark = 0;
    for (let k = 0; k < data.length; k += 4) {
      const ground = data[k] < 30 && Math.abs(data[k] - data[k + 2]) < 14;
      if (!ground && data[k] + data[k + 1] + data[k + 2] < 190) dark += 1;
    }
    return dark;
  }, shot.toString("base64"));
}

async function live(browser) {
  const port = await freePort();
  const box = await freePort();
  const { child, url } = await preview(["--osc", String(port), "--box", `127.0.0.1:${box}`]);
  const config = path.join(work, "mien.toml");
  fs.writeFileSync(config, `[osc]\ntarget = ["127.0.0.1:${port}"]\nranges = true\ncommands = true\nlisten = "127.0.0.1:${box}"\n[status]\npath = ""\n`);
  const csv = path.join(work, "run.csv");
  start("mien", ["run", "--source", "simulated", "--config", config, "--csv", csv]);
  const page = await open(browser, url);
  // Until the act has had its open jaw, after some six seconds, or again later on a busy machine; the last 30 s can be gone
  // back to.
  await page.waitForFunction(() => {
    const { stream } = window.mien;
    const k = stream.units.indexOf("AU26");
    return stream.users[0].samples.some(({ w }) => w[k] > 0.6) && stream.last > 8;
  }, null, { timeout: 180000 });
  await page.click("#pose");
  await page.click("#play");
  const look = async (wanted) => {
    // The sample at which AU26 is largest, or smallest with every other unit near rest.
    await page.evaluate((open) => {
      const { stream } = window.mien;
      const k = stream.units.indexOf("AU26");
      const worth = ({ w }) => (open ? w[k] : -w[k] - w.reduce((sum, one) => sum + one, 0));
      const best = stream.window(0).filter(({ s, w }) => s === 2 && w.length).reduce((a, b) => (worth(b) > worth(a) ? b : a));
      stream.seek(best.t);
      const drawn = window.mien.frames;
      return new Promise((done) => {
        const wait = () => (window.mien.frames > drawn + 2 ? done() : requestAnimationFrame(wait));
        wait();
      });
    }, wanted === "open");
    // Drawn by a busy processor the picture may lag behind: until it stays as it is.
    let dark = await mouth(page);
    for (let k = 0, last = -1; k < 20 && last !== dark; k++) {
      last = dark;
      await page.waitForTimeout(300);
      dark = await mouth(page);
    }
    const found = { ...(await page.evaluate(jaw)), dark };
    await page.screenshot({ path: path.join(shots, `${wanted}.png`) });
    return found;
  };
  const [closed, opened] = [await look("closed"), await look("open")];
  check("the weight of jawOpen is AU26's", Math.abs(closed.weight - closed.unit) + Math.abs(opened.weight - opened.unit) < 1e-3 && opened.weight > 0.6 && closed.weight < 0.1, `${closed.weight.toFixed(2)} closed, ${opened.weight.toFixed(2)} open`);
  check("an open mouth is dark pixels", opened.dark > closed.dark + 400, `${closed.dark} closed, ${opened.dark} open`);
  await page.click("#play");
  await page.click("#pose");
  await until(page, () => window.mien.stream.window(window.mien.stream.present()[0] ?? 0).length > 200);
  const bar = await page.evaluate(() => {
    const { stream } = window.mien;
    const samples = stream.window(stream.present()[0] ?? 0);
    return { bars: document.querySelectorAll("#bars .bar").length, units: stream.units.length, samples: samples.length, rate: document.getElementById("rate").textContent, state: document.getElementById("state").textContent };
  });
  check("a bar for every unit, at the sensor's rate", bar.bars === bar.units && bar.units > 20 && bar.samples > 200, JSON.stringify(bar));
  const moved = new Set();
  for (let k = 0; k < 1200 && moved.size <= 1.5 * bar.units; k++) {
    for (const text of await page.$$eval("#bars .bar", (all) => all.map((one) => `${one.dataset.unit} ${Math.round(10 * one.dataset.weight)}`))) moved.add(text);
    await page.waitForTimeout(100);
  }
  check("bars move", moved.size > 1.5 * bar.units, `${moved.size} lengths seen`);
  const frames = await page.evaluate(async () => {
    const before = window.mien.frames;
    await new Promise((done) => setTimeout(done, 2000));
    return (window.mien.frames - before) / 2;
  });
  console.log(`     ${frames} frames a second here, drawn by the processor`);
  await page.screenshot({ path: path.join(shots, "live.png") });

  await widths(page);
  await controls(page, url);

  // Garbage to both ports.
  const before = await page.evaluate(() => ({ ...window.mien.stream.counts, units: window.mien.stream.units.join() }));
  const socket = dgram.createSocket("udp4");
  let seed = 7;
  const random = () => { seed = (Math.imul(seed, 1103515245) + 12345) >>> 0; return seed >>> 16; };
  for (let k = 0; k < 10000; k++) {
    const bytes = Buffer.from(Array.from({ length: 1 + (random() % 400) }, () => random() & 255));
    const prefix = [Buffer.alloc(0), Buffer.from("#bundle\0\0\0\0\0\0\0\0\x01"), Buffer.from("/face/0/au\0\0,f\0\0"), Buffer.from("/face/7/frame\0\0\0")][k % 4];
    await new Promise((done) => socket.send(Buffer.concat([prefix, bytes]), port, "127.0.0.1", done));
    // What does not fit the receiver's buffer is lost, and then says nothing of the receiver.
    while (k % 50 === 0 && waiting(port) > 1 << 15) await new Promise((done) => setTimeout(done, 2));
  }
  socket.close();
  const { port: pagePort } = new URL(url);
  for (let k = 0; k < 200; k++) {
    await new Promise((done) => {
      const peer = net.connect(Number(pagePort), "127.0.0.1", () => peer.end(Buffer.from(Array.from({ length: 100 }, () => random() & 255)).toString("latin1") + "\r\n\r\n"));
      peer.on("error", done);
      peer.on("close", done);
      peer.resume();
    });
  }
  const ended = await page.evaluate(() => performance.now());
  await until(page, ({ refused, ended }) => window.mien.stream.counts.refused - refused >= 10000 && window.mien.stream.arrived > ended, { ...before, ended });
  const after = await page.evaluate(() => ({ ...window.mien.stream.counts, units: window.mien.stream.units.join(), users: window.mien.stream.present(), arrived: window.mien.stream.arrived }));
  check("10,000 datagrams and 200 connections of garbage change only the counter", after.units === before.units && after.users.length === 1 && after.arrived > ended && after.refused - before.refused >= 10000, `${after.refused - before.refused} refused`);

  // Who may see what.
  const sizes = await Promise.all(["", "look.css", "style.css", "units.js", "drawing.js", "main.js", "stream.js", "head.js", "glb.js", "matrix.js", "panels.js", "picture.js", "control.js"].map((name) => get(url + name)));
  const size = sizes.reduce((sum, { body }) => sum + body.length, 0);
  check("the page is below 1 MB without the mesh", size < 1 << 20 && sizes.every(({ status }) => status === 200), `${size} bytes`);
  check("a name of another's is turned away", (await get(url, { Host: "evil.example" })).status === 421);
  check("there is no picture from a network stream", (await get(`${url}picture?n=1`)).status === 404);
  const elsewhere = Object.values(os.networkInterfaces()).flat().find(({ family, internal }) => family === "IPv4" && !internal);
  if (elsewhere) {
    const refused = await new Promise((done) => {
      const peer = net.connect({ port: Number(pagePort), host: elsewhere.address, timeout: 2000 }, () => { peer.destroy(); done(false); });
      peer.on("error", () => done(true));
      peer.on("timeout", () => { peer.destroy(); done(true); });
    });
    check("the page listens on the loopback interface only", refused);
  }
  // The wireframe, from the side.
  await page.click("#wire");
  await page.mouse.move(400, 300);
  await page.mouse.down();
  await page.mouse.move(300, 320, { steps: 4 });
  await page.mouse.up();
  await page.waitForTimeout(400);
  await page.screenshot({ path: path.join(shots, "wire.png") });
  check("the page complains of nothing", complaints(page).length === 0, complaints(page).slice(0, 3).join(" | "));
  await page.close();
  running[running.indexOf(child) + 1].kill("SIGTERM");
  child.kill();
  return csv;
}

// Every tab at every width, light and dark.
async function widths(page) {
  await judge(page, "live", { check, shots, panels: ["#scene", "#curves", "#bars"], tabs: ["#tab-shapes", "#tab-send", "#tab-session", "#tab-face", "#gains"] });
  await page.click("#gains");
  // The checks see what they are for.
  const wrong = async (what, undo) => {
    await page.evaluate(what);
    const found = { lies: (await page.evaluate(layout)).length, pale: (await page.evaluate(contrast)).found.length, empty: await isEmpty(page, "#tabs") };
    await page.evaluate(undo);
    return found;
  };
  const cut = await wrong(() => { document.getElementById("neutral").style.marginRight = "-60px"; }, () => { document.getElementById("neutral").style.marginRight = ""; });
  check("a button over another one would be seen", cut.lies > 0);
  const pale = await wrong(() => { document.getElementById("neutral").style.color = "#777"; }, () => { document.getElementById("neutral").style.color = ""; });
  check("pale letters would be seen", pale.pale > 0);
  const none = await wrong(() => { document.getElementById("tabs").style.opacity = 0; }, () => { document.getElementById("tabs").style.opacity = ""; });
  check("an empty panel would be seen", none.empty && !cut.empty);
  await page.setViewportSize({ width: 1280, height: 800 });
}

// What is pressed does what it says.
async function controls(page, url) {
  const said = (pattern) => until(page, (text) => new RegExp(text).test(document.getElementById("said").textContent), pattern).then(() => page.textContent("#said"));
  await until(page, () => window.mien.stream.present().length > 0);
  await page.click("#neutral");
  check("the box is asked for a neutral face", /^command sent .*neutral/.test(await said("command sent")), await page.textContent("#said"));
  await page.click("#freeze");
  const answer = await said("frozen");
  // The button follows the stream, which on a busy machine comes after the answer.
  await until(page, () => document.getElementById("freeze").ariaPressed === "true");
  check("freezing is shown", /frozen/.test(answer) && (await page.textContent("#freeze")) === "Resume", answer);
  const other = await open(page.context().browser(), url);
  await until(other, () => document.getElementById("freeze").ariaPressed === "true");
  check("a second reader of the page sees that learning is frozen", (await other.textContent("#freeze")) === "Resume");
  await other.close();
  await page.click("#freeze");
  await said("resumed");
  await page.click("#record");
  await until(page, () => /0:\d[1-9]/.test(document.getElementById("record").textContent));
  const running = await page.textContent("#record");
  const coming = page.waitForEvent("download");
  await page.click("#record");
  const recorded = path.join(work, "recorded.csv");
  await (await coming).saveAs(recorded);
  const rows = fs.readFileSync(recorded, "utf8").trim().split("\n");
  const cells = rows[0].split(",").length;
  check("a recording is a table with its time and size shown", rows.length > 10 && rows.every((row) => row.split(",").length === cells) && /0:\d\d · \d/.test(running), `${rows.length} rows, ${running}`);
  // A receiver that is connected by name.
  const socket = dgram.createSocket("udp4");
  const heard = new Promise((done) => socket.once("message", done));
  await new Promise((done) => socket.bind(0, "127.0.0.1", done));
  await page.click("#tab-send");
  await page.selectOption("#receiver-id", "vseeface");
  await page.fill("#receiver-port", String(socket.address().port));
  check("the box's lines name it", (await page.textContent("#lines")).includes(`target = "127.0.0.1:${socket.address().port}"`));
  await page.click("#receiver-connect");
  check("a receiver connected by name hears VMC", (await heard).includes("/VMC/Ext/"));
  await page.getByRole("button", { name: "Stop" }).click();
  socket.close();
  // A slider holds its shape.
  await page.click("#tab-shapes");
  await page.locator(".slider input").first().evaluate((slider) => { slider.value = 0.75; slider.dispatchEvent(new Event("input")); });
  const held = () => Math.abs(window.mien.heads[0].weights[0] - 0.75) < 1e-6;
  await until(page, held);
  check("a slider holds its shape", await page.evaluate(held));
  await page.click("#hands-off");
  await page.click("#tab-face");
  const post = await new Promise((done, fail) => http.request(`${url}command?what=forget&user=0`, { method: "POST" }, (answer) => { answer.resume(); done(answer.statusCode); }).on("error", fail).end());
  check("who is not the page changes nothing", post === 403, post);
}

async function table(browser, csv) {
  const { child, url } = await preview(["--csv", csv]);
  const page = await open(browser, url);
  // Until all of the table has come.
  for (let last = -1, now = 0; now !== last; ) {
    last = now;
    await page.waitForTimeout(1000);
    now = await page.evaluate(() => window.mien.stream.last);
  }
  await page.click("#play");
  const jump = (share) => page.evaluate((to) => {
    const scrub = document.getElementById("scrub");
    scrub.value = to;
    scrub.dispatchEvent(new Event("input"));
    return new Promise((done) => setTimeout(() => done({ now: window.mien.stream.now() - window.mien.stream.first, length: window.mien.stream.last - window.mien.stream.first }), 300));
  }, share);
  const [half, same] = [await jump(0.5), await jump(0.5)];
  check("a table can be paused and scrubbed", Math.abs(half.now - half.length / 2) < 0.1 && half.now === same.now, `${half.now.toFixed(2)} of ${half.length.toFixed(2)} s`);
  // A head by drag and drop: a dense one made elsewhere would do as well.
  const head = path.join(work, "dropped.glb");
  execFileSync(path.join(programs, "mien-studio"), ["head", "--out", head]);
  const bytes = fs.readFileSync(head).toString("base64");
  await page.evaluate(async (base64) => {
    const data = new DataTransfer();
    data.items.add(new File([Uint8Array.from(atob(base64), (c) => c.charCodeAt(0))], "dropped.glb"));
    dispatchEvent(new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true }));
  }, bytes);
  await until(page, () => window.mien.heads[0]?.name === "dropped.glb");
  check("a head can be dropped on the page", (await page.evaluate(() => window.mien.heads[0].name)) === "dropped.glb");
  await page.screenshot({ path: path.join(shots, "table.png") });
  check("the page complains of nothing", complaints(page).length === 0, complaints(page).slice(0, 3).join(" | "));
  await page.close();
  child.kill();
}

// A row of a table whose mouth is covered, as by a mask: its bars are grey, and its region says so.
async function covered(browser) {
  const csv = path.join(work, "covered.csv");
  const header = "time_us,user,state,w_AU26,w_AU12L,w_AU12R,w_AU25,w_AU9L,w_AU34L,w_AU1L,w_AU1R,w_AU43L,s_brow_L,s_brow_R,s_eye_L,s_eye_R,s_nose,s_mouth";
  fs.writeFileSync(csv, [header, ...[0, 1, 2].map((k) => `${k * 500000},0,tracking,0,0.12,0,0,0.3,0,0.7,0.6,0.2,1,1,1,1,1,0`), ""].join("\n"));
  const { child, url } = await preview(["--csv", csv]);
  const page = await open(browser, url);
  await page.click("#play");
  await until(page, () => document.querySelector("#bars .covered"));
  const told = await page.$$eval("#bars .region", (all) => all.map((one) => one.innerText.replaceAll(/\s+/g, " ").trim()).join(", "));
  const grey = await page.$$eval("#bars .covered", (all) => all.map(({ dataset }) => dataset.unit).join(" "));
  check("what is covered is grey, and its region says so", told === "Brows, Eyes, Nose and cheeks partly covered, Mouth covered, Jaw covered" && grey === "AU34L AU12L AU12R AU25 AU26", `${told}; ${grey}`);
  const faint = (await page.evaluate(contrast)).found;
  check("its letters can be read", faint.length === 0, faint.join(" | "));
  await page.screenshot({ path: path.join(shots, "covered.png") });
  await page.close();
  child.kill();
}

async function recording(browser) {
  const session = path.join(work, "session");
  execFileSync(path.join(programs, "mien-studio"), ["record", "--source", "simulated:two", "--seconds", "3", "--out", session]);
  const { child, url } = await preview(["--source", session]);
  const page = await open(browser, url);
  await page.waitForFunction(() => window.mien.stream.last - window.mien.stream.first > 2.8);
  await page.click("#play");
  await page.evaluate(() => { window.mien.stream.seek(window.mien.stream.last - 0.2); });
  await until(page, () => window.mien.stream.present().length === 2);
  const users = await page.evaluate(() => window.mien.stream.present());
  check("two people are two users", users.length === 2, users.join());
  await page.locator("#users button", { hasText: "All" }).click();
  const count = () => {
    const canvas = document.getElementById("picture");
    const { data } = canvas.getContext("2d").getImageData(0, 0, 640, 480);
    let [lit, drawn] = [0, 0];
    for (let k = 0; k < data.length; k += 4) {
      if (data[k] + data[k + 1] + data[k + 2] > 60) lit += 1;
      if (data[k] < 40 && data[k + 1] > 150 && data[k + 2] > 220) drawn += 1;
    }
    return { lit, drawn, hidden: canvas.parentElement.hidden };
  };
  // Drawn by a busy processor the picture comes late.
  let seen;
  for (let k = 0; k < 100; k++) {
    seen = await page.evaluate(count);
    if (seen.drawn > 300) break;
    await page.waitForTimeout(300);
  }
  check("the recording's picture is shown with landmarks", !seen.hidden && seen.lit > 50000 && seen.drawn > 300, JSON.stringify(seen));
  const ready = await page.$$eval("#bars .ready", (all) => all.filter((one) => one.style.visibility === "visible").length);
  check("ranges and readiness are shown", ready > 20, ready);
  // Whose bars these are, and that a plate changes it.
  const whose = () => page.textContent("#whose");
  check("bars say whose they are", /Person 1/.test(await whose()), await whose());
  await page.locator("#names .plate", { hasText: "Person 2" }).click();
  await until(page, () => /Person 2/.test(document.getElementById("whose").textContent));
  check("a name plate shows the other's bars", /Person 2/.test(await whose()) && (await page.locator("#names .plate").count()) === 2);
  await page.locator("#names .plate", { hasText: "Person 1" }).click();
  await judge(page, "two", { check, shots, panels: ["#scene", "#picture", "#depth", "#curves", "#bars"] });
  await page.setViewportSize({ width: 1280, height: 800 });
  // Depth large, and the head beside it.
  await page.locator(".view:has(#depth) > .plate").click();
  const wide = (id) => page.evaluate((one) => document.getElementById(one).getBoundingClientRect().width, id);
  check("depth can be made large", (await wide("depth")) > 1.2 * (await wide("view")));
  await page.screenshot({ path: path.join(shots, "recording.png") });
  check("the page complains of nothing", complaints(page).length === 0, complaints(page).slice(0, 3).join(" | "));
  await page.close();
  child.kill();
}

// What `mien-studio inspect` writes: a recording and a table that are played, and what stands still.
async function inspected(browser, csv) {
  const session = path.join(work, "session");
  const model = path.join(__dirname, "../../config/face.model");
  for (const [name, what] of [["recording", session], ["run", csv], ["model", model]]) {
    const out = path.join(shots, `inspect-${name}.html`);
    execFileSync(path.join(programs, "mien-studio"), ["inspect", what, "--out", out]);
    const page = await noted(browser);
    await page.goto(`file://${out}`);
    const plays = name !== "model";
    if (plays) {
      await page.waitForFunction(() => window.mien?.charts.length > 5);
      // The middle of what there is.
      await page.locator("#scrub").evaluate((scrub) => { scrub.value = 0.5; scrub.dispatchEvent(new Event("input")); });
      await page.waitForTimeout(500);
    }
    const panels = { recording: ["#colour", "#depth", ".chart canvas"], run: ["#colour", ".chart canvas"], model: [".pictures"] }[name];
    await judge(page, `inspect-${name}`, { check, shots, panels });
    if (plays) await played(page, name);
    check(`inspect-${name}: ${(fs.statSync(out).size / 1e6).toFixed(1)} MB, asks for nothing, complains of nothing`, fs.statSync(out).size < 25e6 && !complaints(page).length, complaints(page).slice(0, 3).join(" | "));
    await page.close();
  }
}

// Pictures, curves and their values go along with the time.
async function played(page, name) {
  await page.setViewportSize({ width: 1600, height: 1000 });
  const seen = async (share) => {
    await page.locator("#scrub").evaluate((scrub, to) => { scrub.value = to; scrub.dispatchEvent(new Event("input")); }, share);
    await page.waitForTimeout(600);
    const at = await page.evaluate(() => ({
      now: window.mien.now, cursors: [...new Set([...document.querySelectorAll(".cursor")].map(({ style }) => style.left))].length,
      frames: window.mien.screens.map(({ shown }) => shown?.n ?? null), values: document.querySelector("#curves").innerText,
    }));
    return { ...at, picture: (await page.locator("#colour").screenshot()).toString("base64") };
  };
  const [early, late] = [await seen(0.25), await seen(0.75)];
  check(`inspect-${name}: one time for pictures, curves and values`, late.now > early.now && early.cursors === 1 && late.cursors === 1 && early.values !== late.values && early.picture !== late.picture
    && (name === "run" || (late.frames[0] === late.frames[1] && late.frames[0] > early.frames[0])), JSON.stringify([early.now, late.now, early.frames, late.frames]));
  const box = await page.locator(".chart .frame").first().boundingBox();
  await page.mouse.click(box.x + 0.5 * box.width, box.y + 20);
  const clicked = await page.evaluate(() => window.mien.now);
  check(`inspect-${name}: a press in a curve goes there`, clicked > early.now && clicked < late.now, clicked.toFixed(2));
  await page.keyboard.press("Space");
  await page.waitForTimeout(700);
  const after = await page.evaluate(() => ({ now: window.mien.now, playing: window.mien.playing }));
  await page.keyboard.press("Space");
  check(`inspect-${name}: it plays`, after.now > clicked + 0.2 && after.playing, after.now.toFixed(2));
}

// Presses Tab until something is focused.
async function tabTo(page, wanted) {
  for (let k = 0; k < 120; k++) {
    await page.keyboard.press("Tab");
    if (await page.evaluate((wanted) => document.activeElement.matches(wanted), wanted)) return true;
  }
  return false;
}

// A gesture is set up, stopped, changed and changed back, by keyboard and then by one switch.
async function setUp(page, name) {
  await page.waitForFunction(() => document.querySelector(".setup button"), null, { timeout: 20000 }).catch(() => null);
  if (await page.locator("details#setups").count()) {
    check(`${name}: set-ups are opened by keyboard`, await tabTo(page, "#setups summary"));
    await page.keyboard.press("Enter");
  }
  const [teach, undo, level] = [".setup button", ".setup button + button", ".setup input"];
  const runs = (on) => until(page, (on) => Boolean(document.querySelector(".setup button").dataset.runs) === on, on);
  const isDisabled = (off) => until(page, (off) => document.querySelector(".setup button + button").disabled === off, off);
  const said = () => page.textContent(".setup p[role=status]");
  check(`${name}: a set-up is reached by Tab`, await tabTo(page, teach));
  const outline = await page.evaluate(() => getComputedStyle(document.activeElement).outlineWidth);
  check(`${name}: what is focused is seen`, parseFloat(outline) >= 2, outline);
  await page.keyboard.press("Enter");
  check(`${name}: Enter starts it and it says what to do`, await runs(true) && /face|expression/.test(await said()), await said());
  await page.keyboard.press("Space");
  check(`${name}: Space stops it`, await runs(false) && (await said()) === "", await said());
  await tabTo(page, level);
  await page.keyboard.press("ControlOrMeta+A");
  await page.keyboard.type("0.5");
  await page.keyboard.press("Enter");
  check(`${name}: a level is typed`, await isDisabled(false) !== null);
  await page.screenshot({ path: path.join(shots, `setup-${name.replaceAll(" ", "-")}.png`), fullPage: true });
  await tabTo(page, undo);
  await page.keyboard.press("Space");
  check(`${name}: and undone`, await isDisabled(true) !== null && (await page.inputValue(level)) === "0.30", await page.inputValue(level));
  await page.locator("#setups input[type=checkbox]").check();
  check(`${name}: for one switch the focus moves by itself`, await until(page, () => document.activeElement.matches(".setup button")) !== null);
  await page.keyboard.press("Enter");
  check(`${name}: the switch starts it`, await runs(true) !== null);
  await page.keyboard.press("Enter");
  check(`${name}: and stops it`, await runs(false) !== null);
}

// The box's own page, where this build has it, and the set-up of gestures there and in the preview of the same box.
async function box(browser) {
  const [port, osc, commands] = [await freePort(), await freePort(), await freePort()];
  const config = path.join(work, "box.toml");
  fs.writeFileSync(config, `[osc]\ntarget = ["127.0.0.1:${osc}"]\nlevels = true\nlisten = "127.0.0.1:${commands}"\n[page]\nenabled = true\nlisten = "127.0.0.1:${port}"\n[[gesture]]\nname = "smile"\nof = "AU12L + AU12R"\non = 0.3\noff = 0.2\n[status]\npath = ""\n`);
  const child = start("mien", ["run", "--source", "simulated:two", "--config", config], { stdio: ["ignore", "ignore", "pipe"] });
  let problem = "";
  child.stderr.on("data", (data) => { problem += data; });
  const ended = new Promise((resolve) => child.on("exit", () => resolve(true)));
  if (await Promise.race([ended, new Promise((resolve) => setTimeout(() => resolve(false), 3000))])) {
    console.log(`!! skipped: the box's page: ${problem.trim().split("\n").at(-1)}`);
    return;
  }
  const page = await noted(browser);
  await page.goto(`http://127.0.0.1:${port}/`);
  await page.waitForFunction(() => document.querySelectorAll("article.card:not([hidden])").length === 2);
  await page.waitForFunction(() => [...document.querySelectorAll(".bar")].some(({ dataset }) => dataset.weight > 0.2));
  await page.waitForFunction(() => document.querySelector(".setup"));
  await judge(page, "box", { check, shots, panels: ["article.card", "#gestures", "#setups"] });
  await setUp(page, "box");
  const freeze = page.locator("article.card:not([hidden]) button", { hasText: "Freeze" }).first();
  await freeze.click();
  await page.waitForFunction(() => /frozen/.test(document.querySelector("article.card .badge").textContent), null, { timeout: 20000 }).catch(() => null);
  check("freezing shows on the box's page, in the words of the other", /frozen/.test(await page.textContent("article.card .badge")) && (await page.locator("button", { hasText: "Resume" }).count()) === 1);
  check("the box's page complains of nothing", !complaints(page).length, complaints(page).slice(0, 3).join(" | "));
  // With another gesture before it, the first one has another number.
  const before = fs.readFileSync(config, "utf8");
  const names = () => page.waitForFunction((count) => document.querySelectorAll(".setup").length === count && document.querySelector(".setup h3").textContent, count, { timeout: 20000 });
  let count = 2;
  fs.writeFileSync(config, before.replace("[[gesture]]", "[[gesture]]\nname = \"brows\"\n[[gesture]]"));
  child.kill("SIGHUP");
  const more = await names().then((found) => found.jsonValue()).catch(() => "none");
  count = 1;
  fs.writeFileSync(config, before);
  child.kill("SIGHUP");
  const again = await names().then((found) => found.jsonValue()).catch(() => "none");
  check("an open page shows the gestures of a configuration that is read again", more === "brows" && again === "smile", `${more}, ${again}`);
  await page.close();
  const shown = await preview(["--osc", String(osc), "--box", `127.0.0.1:${commands}`]);
  const other = await open(browser, shown.url);
  await setUp(other, "preview");
  check("the preview complains of nothing", !complaints(other).length, complaints(other).slice(0, 3).join(" | "));
  await other.close();
  shown.child.kill();
  child.kill("SIGTERM");
}

// A session in which nobody is seen.
async function nobody(browser) {
  const session = path.join(work, "nobody");
  execFileSync(path.join(programs, "mien-studio"), ["record", "--source", "simulated:empty", "--seconds", "1", "--out", session]);
  const { child, url } = await preview(["--source", session]);
  const page = await open(browser, url);
  await page.waitForFunction(() => window.mien.stream.last - window.mien.stream.first > 0.9);
  await page.click("#play");
  const empty = await page.evaluate(() => {
    const { stream } = window.mien;
    stream.seek((stream.first + stream.last) / 2);
    return { people: stream.present().length, number: String(stream.unpeopled()) };
  });
  // The last that came; one already shown is not asked for again.
  const shown = () => page.answers.findLast((one) => /picture\?n=\d+$/.test(one.url()))?.headers()["x-frame"];
  // Drawn by a busy processor the picture comes late.
  for (let k = 0; k < 100 && shown() !== empty.number; k++) await page.waitForTimeout(300);
  check("the picture of a frame with nobody is shown", empty.people === 0 && Number(empty.number) > 0 && shown() === empty.number, `${empty.number} of ${shown()}`);
  check("the page complains of nothing", complaints(page).length === 0, complaints(page).slice(0, 3).join(" | "));
  await page.close();
  child.kill();
}

(async () => {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM || execFileSync("sh", ["-c", "command -v chromium"]).toString().trim(),
    args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  }).catch((error) => error);
  if (browser instanceof Error) {
    console.log(`!! skipped: the page in a browser: chromium does not start: ${browser.message.split("\n")[0]}`);
    return;
  }
  try {
    const csv = await live(browser);
    await table(browser, csv);
    await covered(browser);
    await recording(browser);
    await inspected(browser, csv);
    await box(browser);
    await nobody(browser);
  } finally {
    await browser.close();
  }
})()
  .catch((error) => { console.log(`FAIL ${error.stack}`); failures += 1; })
  .finally(() => {
    for (const child of running) child.kill();
    fs.rmSync(work, { recursive: true, force: true });
    console.log(failures ? `${failures} failed` : "all well");
    process.exitCode = failures ? 1 : 0;
  });

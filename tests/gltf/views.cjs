// A GLB as three.js draws it, in headless Chromium: from six sides, for the neutral face and each shape named; one picture, a row a shape.
// npm install three@0.187.0 playwright-core@1.56.1 && NODE_PATH=node_modules node views.cjs FILE.glb OUT.png [[NAME=]SHAPE[:WEIGHT],...]...
// Shapes joined by a comma are shown together. Fails if a view is empty, the page says an error, or a view differs from that of
// KEPT, a JPEG of half the size (WRITE=1 writes it anew). CLOSE=2 looks from half the distance.
const { chromium } = require("playwright-core");
const fs = require("node:fs");
const http = require("node:http");
const path = require("node:path");

const [file, out, ...shapes] = process.argv.slice(2);
const three = path.dirname(path.dirname(require.resolve("three")));
const SIDE = 320;
const YAWS = [0, 40, 90, 180, 270, 320];
const { KEPT, WRITE } = process.env;
// Share of a view's pixels that may differ by more than a picture's compression does; a brow that is lowered otherwise is .0027.
const [APART, LEVELS] = [0.0015, 48];

const page = `<script type="importmap">{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<body style="margin:0"><script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
const { scene } = await new GLTFLoader().loadAsync('/file.glb');
const world = new THREE.Scene();
world.background = new THREE.Color(0x8a929c);
world.add(scene, new THREE.HemisphereLight(0xffffff, 0x888888, 2));
const lamp = new THREE.DirectionalLight(0xffffff, 2);
world.add(lamp, lamp.target);
const box = new THREE.Box3().setFromObject(scene);
const middle = box.getCenter(new THREE.Vector3()), half = box.getSize(new THREE.Vector3()).length() / 2;
const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
renderer.setSize(${SIDE}, ${SIDE});
const sheet = document.createElement('canvas');
const rows = ${JSON.stringify(["", ...shapes])};
[sheet.width, sheet.height] = [${SIDE * YAWS.length}, ${SIDE} * rows.length];
document.body.append(sheet);
const camera = new THREE.PerspectiveCamera(24, 1, half / 50, half * 20);
const close = ${process.env.CLOSE || 1};
rows.forEach((row, y) => {
  const on = Object.fromEntries(row.split('=').at(-1).split(',').map((word) => word.split(':')).map(([name, weight]) => [name, +(weight ?? 1)]));
  scene.traverse((o) => o.morphTargetDictionary && Object.entries(o.morphTargetDictionary).forEach(([name, k]) => {
    o.morphTargetInfluences[k] = on[name] ?? 0;
  }));
  ${JSON.stringify(YAWS)}.forEach((yaw, x) => {
    const a = yaw * Math.PI / 180, far = half * 4.6 / close;
    camera.position.set(middle.x + far * Math.sin(a), middle.y + half * 0.1, middle.z + far * Math.cos(a));
    camera.lookAt(middle.x, middle.y + half * 0.12, middle.z);
    lamp.position.copy(camera.position).add(new THREE.Vector3(0, half, 0));
    lamp.target.position.copy(middle);
    renderer.render(world, camera);
    sheet.getContext('2d').drawImage(renderer.domElement, x * ${SIDE}, y * ${SIDE});
  });
});
const seen = sheet.getContext('2d').getImageData(0, 0, sheet.width, sheet.height).data;
const filled = [];
for (let y = 0; y < rows.length; y++) for (let x = 0; x < ${YAWS.length}; x++) {
  let n = 0;
  for (let j = 0; j < ${SIDE}; j++) for (let i = 0; i < ${SIDE}; i++) {
    const at = 4 * ((y * ${SIDE} + j) * sheet.width + x * ${SIDE} + i);
    n += seen[at] !== 0x8a || seen[at + 2] !== 0x9c;
  }
  filled.push(n / ${SIDE} ** 2);
}
const pixels = (source, wide, high) => {
  const canvas = Object.assign(document.createElement('canvas'), { width: wide, height: high });
  canvas.getContext('2d').drawImage(source, 0, 0, wide, high);
  return { canvas, data: canvas.getContext('2d').getImageData(0, 0, wide, high).data };
};
window.half = pixels(sheet, sheet.width / 2, sheet.height / 2).canvas.toDataURL('image/jpeg', 0.85);
window.apart = [];
if (${Boolean(KEPT) && !WRITE}) {
  const kept = await createImageBitmap(await (await fetch('/kept.jpg')).blob());
  const [a, b] = [kept, sheet].map((source) => pixels(source, kept.width, kept.height).data);
  const side = kept.width / ${YAWS.length};
  rows.forEach((row, y) => ${JSON.stringify(YAWS)}.forEach((yaw, x) => {
    let sum = kept.height === side * rows.length ? 0 : Infinity;
    for (let j = y * side; j < (y + 1) * side; j++) for (let i = x * side; i < (x + 1) * side; i++) {
      const at = 4 * (j * kept.width + i);
      sum += [0, 1, 2].some((c) => Math.abs(a[at + c] - b[at + c]) > ${LEVELS});
    }
    window.apart.push([sum / side ** 2, row.split('=')[0] || 'neutral', yaw]);
  }));
}
window.filled = filled;
</script>`;

const server = http.createServer((request, answer) => {
  const url = request.url;
  const from = url === "/file.glb" ? file : url === "/kept.jpg" ? KEPT : path.join(three, url.replace(/^\/three\//, ""));
  answer.setHeader("Content-Type", url.endsWith(".js") ? "text/javascript" : url === "/" ? "text/html" : "application/octet-stream");
  answer.end(url === "/" ? page : fs.existsSync(from) ? fs.readFileSync(from) : "");
});

server.listen(0, "127.0.0.1", async () => {
  const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
  const tab = await browser.newPage({ viewport: { width: SIDE * YAWS.length, height: SIDE * (shapes.length + 1) } });
  const errors = [];
  tab.on("pageerror", (error) => errors.push(String(error)));
  await tab.goto(`http://127.0.0.1:${server.address().port}/`);
  await tab.waitForFunction("window.filled", null, { timeout: 120000 }).catch((error) => errors.push(String(error)));
  const filled = await tab.evaluate("window.filled || []");
  const [half, apart] = await tab.evaluate("[window.half, window.apart || []]");
  await tab.screenshot({ path: out });
  if (WRITE) fs.writeFileSync(KEPT, Buffer.from(half.split(",")[1], "base64"));
  await browser.close();
  server.close();
  if (!filled.length || filled.some((share) => share < 0.05)) errors.push(`an empty view: ${filled}`);
  const worst = apart.sort((a, b) => b[0] - a[0])[0];
  for (const [by, row, yaw] of apart.filter(([by]) => !(by < APART))) errors.push(`${row} from ${yaw} degrees differs in ${(100 * by).toFixed(2)} % of its pixels from ${KEPT}`);
  if (worst) console.log(`     at most ${(100 * worst[0]).toFixed(2)} % of a view differ from ${KEPT}`);
  console.log(errors.length ? `FAIL ${file}: ${errors.join("; ")}` : `ok   ${file}: ${filled.length} views, ${out}`);
  process.exitCode = errors.length ? 1 : 0;
});

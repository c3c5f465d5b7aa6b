// A head in three.js, driven by mien: a browser cannot receive UDP, so this hands on what OSC says as server-sent events.
//
//   npm install three@0.187.0 && node serve.mjs HEAD.glb [OSC_PORT] [PAGE_PORT]
//
// then open http://127.0.0.1:8090 and run `mien run` with `target = "127.0.0.1:9140"` in its section [osc]. HEAD.glb is what `mien-studio bake` or `mien-studio head` wrote.
import dgram from "node:dgram";
import fs from "node:fs";
import http from "node:http";
import { createRequire } from "node:module";
import path from "node:path";
import { fileURLToPath } from "node:url";

const [head, osc = 9140, port = 8090] = process.argv.slice(2);
const here = path.dirname(fileURLToPath(import.meta.url));
// Where three is: beside this file, or where it is run.
const three = [import.meta.url, `file://${process.cwd()}/`]
  .map((from) => { try { return path.resolve(path.dirname(createRequire(from).resolve("three")), ".."); } catch { return null; } })
  .find(Boolean);
if (!head || !three) {
  console.error(head ? "three is missing: npm install three@0.187.0" : "expected a head: node serve.mjs HEAD.glb");
  process.exit(64);
}

// Calls `take` with address and arguments of every message of a datagram.
function messages(data, take) {
  if (data.toString("latin1", 0, 8) === "#bundle\0") {
    for (let at = 16; at + 4 <= data.length;) {
      const size = data.readInt32BE(at);
      if (size <= 0) return;
      messages(data.subarray(at + 4, at + 4 + size), take);
      at += 4 + size;
    }
    return;
  }
  const text = (at) => { const end = data.indexOf(0, at); return [data.toString("latin1", at, end), (end >> 2 << 2) + 4]; };
  const [address, tags] = text(0);
  let [kinds, at] = text(tags);
  const values = [];
  for (const kind of kinds.slice(1)) {
    if (kind === "s") { const [value, next] = text(at); values.push(value); at = next; continue; }
    values.push(kind === "f" ? data.readFloatBE(at) : data.readInt32BE(at));
    at += 4;
  }
  take(address, values);
}

const pages = new Set();
const units = {};
let pose = null;
dgram.createSocket("udp4").on("message", (data) => {
  try {
    messages(data, (address, values) => {
      const unit = /\/0\/au\/([^/]+)$/.exec(address);
      if (unit) units[unit[1]] = values[0];
      else if (address.endsWith("/0/pose")) pose = values;
    });
  } catch {
    return; // not OSC
  }
  const event = `data: ${JSON.stringify({ units, pose })}\n\n`;
  for (const page of pages) page.write(event);
}).bind(Number(osc), "127.0.0.1");

const kinds = { ".html": "text/html", ".js": "text/javascript", ".glb": "model/gltf-binary" };
http.createServer((request, answer) => {
  const asked = new URL(request.url, "http://localhost").pathname;
  if (asked === "/events") {
    answer.writeHead(200, { "Content-Type": "text/event-stream" });
    pages.add(answer);
    request.on("close", () => pages.delete(answer));
    return;
  }
  const file = asked === "/" ? path.join(here, "index.html")
    : asked === "/head.glb" ? head
    : asked.startsWith("/three/") ? path.join(three, path.normalize(asked.slice(7)))
    : null;
  if (!file || !fs.existsSync(file)) return answer.writeHead(404).end();
  answer.writeHead(200, { "Content-Type": kinds[path.extname(file)] ?? "text/plain" });
  fs.createReadStream(file).pipe(answer);
}).listen(Number(port), "127.0.0.1", () => console.log(`open http://127.0.0.1:${port} (OSC at 127.0.0.1:${osc})`));

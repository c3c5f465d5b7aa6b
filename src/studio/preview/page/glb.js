// Reads binary glTF: triangles of all meshes in one vertex list, with colours, one texture per material, and morph targets
// (sparse or dense) as a list per vertex of what moves it. Frame: y up, metres, as the file has it; node transforms applied.
// Normals of targets are not read but found from the triangles, so that every file is shaded alike.

import { identity, multiply, rotation, scaling, translation } from "./matrix.js";

const TYPES = { 5120: Int8Array, 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
const WIDTHS = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT4: 16 };
const NORMALISED = { 5120: 127, 5121: 255, 5122: 32767, 5123: 65535 };
const NOTHING_M = 1e-7;
const NOTHING_NORMAL = 2e-3;

function chunks(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < 20 || view.getUint32(0, true) !== 0x46546c67) throw new Error("not a GLB file (binary glTF 2.0)");
  if (view.getUint32(4, true) !== 2) throw new Error("not glTF version 2");
  const length = view.getUint32(12, true);
  const json = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, length)));
  const at = 20 + length;
  const bin = at + 8 <= buffer.byteLength ? new Uint8Array(buffer, at + 8, view.getUint32(at, true)) : new Uint8Array(0);
  return { json, bin };
}

class Reader {
  constructor({ json, bin }) {
    this.json = json;
    this.bin = bin;
  }

  // `count` rows of `width` numbers from a buffer view, as floats or as they are.
  rows(view, offset, type, width, count, normalised) {
    const from = this.json.bufferViews[view];
    if (from.extensions || (from.buffer ?? 0) !== 0) throw new Error("compressed or external data; export as one plain .glb");
    const kind = TYPES[type];
    const size = kind.BYTES_PER_ELEMENT;
    const stride = from.byteStride ?? size * width;
    const start = this.bin.byteOffset + (from.byteOffset ?? 0) + offset;
    const data = new DataView(this.bin.buffer);
    const get = { 5120: "getInt8", 5121: "getUint8", 5122: "getInt16", 5123: "getUint16", 5125: "getUint32", 5126: "getFloat32" }[type];
    const out = type === 5125 ? new Uint32Array(count * width) : new Float32Array(count * width);
    const scale = normalised ? 1 / NORMALISED[type] : 1;
    for (let row = 0; row < count; row++) {
      for (let k = 0; k < width; k++) {
        out[row * width + k] = data[get](start + row * stride + k * size, true) * scale;
      }
    }
    return out;
  }

  accessor(number) {
    const a = this.json.accessors[number];
    const width = WIDTHS[a.type];
    const out = a.bufferView === undefined
      ? new Float32Array(a.count * width)
      : this.rows(a.bufferView, a.byteOffset ?? 0, a.componentType, width, a.count, a.normalized);
    if (a.sparse) {
      const { at, values } = this.sparse(a, width);
      for (let k = 0; k < at.length; k++) {
        for (let c = 0; c < width; c++) out[at[k] * width + c] = values[k * width + c];
      }
    }
    return { values: out, width, count: a.count };
  }

  sparse(a, width) {
    const { count, indices, values } = a.sparse;
    const at = this.rows(indices.bufferView, indices.byteOffset ?? 0, indices.componentType, 1, count);
    if (at.some((row) => row >= a.count)) throw new Error("a sparse index is outside its accessor");
    return { at, values: this.rows(values.bufferView, values.byteOffset ?? 0, a.componentType, width, count, a.normalized) };
  }
}

// World matrices of all nodes of the scene, by node.
function places(json) {
  const nodes = json.nodes ?? [];
  const world = new Map();
  const visit = (k, parent, depth) => {
    const node = nodes[k];
    if (!node || depth > 200) return;
    const own = node.matrix ?? multiply(
      multiply(translation(node.translation ?? [0, 0, 0]), rotation(node.rotation ?? [0, 0, 0, 1])),
      scaling(node.scale ?? [1, 1, 1]),
    );
    const matrix = multiply(parent, own);
    world.set(k, matrix);
    for (const child of node.children ?? []) visit(child, matrix, depth + 1);
  };
  const roots = json.scenes?.[json.scene ?? 0]?.nodes ?? nodes.map((_, k) => k);
  // VRM 0 looks the other way.
  const start = json.extensions?.VRM ? rotation([0, 1, 0, 0]) : identity();
  for (const root of roots) visit(root, start, 0);
  return world;
}

// The node of the head in a skeleton, if there is one: what it and its children carry turns with the head.
function headOf(json) {
  const bones = json.extensions?.VRMC_vrm?.humanoid?.humanBones?.head?.node
    ?? json.extensions?.VRM?.humanoid?.humanBones?.find?.(({ bone }) => bone === "head")?.node;
  const joints = new Set((json.skins ?? []).flatMap((skin) => skin.joints));
  return bones ?? [...joints].find((k) => /head$/i.test(json.nodes[k]?.name ?? ""));
}

// Shares of the head's turns, by vertex: what its joints weigh; all of it for what no skeleton carries.
function turning(reader, node, primitive, count, head) {
  const { json } = reader;
  const { JOINTS_0: joints, WEIGHTS_0: weights } = primitive.attributes;
  const out = new Float32Array(count).fill(1);
  if (head === undefined || node.skin === undefined || joints === undefined || weights === undefined) return out;
  const below = new Set();
  const add = (k) => {
    if (below.has(k)) return;
    below.add(k);
    for (const child of json.nodes[k]?.children ?? []) add(child);
  };
  add(head);
  const carried = json.skins[node.skin].joints.map((k) => below.has(k));
  const [numbers, shares] = [reader.accessor(joints).values, reader.accessor(weights).values];
  for (let v = 0; v < count; v++) {
    out[v] = 0;
    for (let k = 0; k < 4; k++) if (carried[numbers[4 * v + k]]) out[v] += shares[4 * v + k];
  }
  return out;
}

function turned(m, values, asPlace) {
  const out = new Float32Array(values.length);
  for (let k = 0; k < values.length; k += 3) {
    const [x, y, z] = [values[k], values[k + 1], values[k + 2]];
    for (let r = 0; r < 3; r++) out[k + r] = m[r] * x + m[4 + r] * y + m[8 + r] * z + (asPlace ? m[12 + r] : 0);
  }
  return out;
}

// Vertices at one place are one for shading.
function welded(positions) {
  const known = new Map();
  const of = new Uint32Array(positions.length / 3);
  for (let v = 0; v < of.length; v++) {
    const key = `${positions[3 * v].toFixed(6)},${positions[3 * v + 1].toFixed(6)},${positions[3 * v + 2].toFixed(6)}`;
    let at = known.get(key);
    if (at === undefined) known.set(key, (at = v));
    of[v] = at;
  }
  return of;
}

function addNormal(out, p, a, b, c, at) {
  const [ux, uy, uz] = [p[3 * b] - p[3 * a], p[3 * b + 1] - p[3 * a + 1], p[3 * b + 2] - p[3 * a + 2]];
  const [vx, vy, vz] = [p[3 * c] - p[3 * a], p[3 * c + 1] - p[3 * a + 1], p[3 * c + 2] - p[3 * a + 2]];
  const n = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
  for (const corner of at) for (let k = 0; k < 3; k++) out[3 * corner + k] += n[k];
}

function normalise(n, v) {
  const length = Math.hypot(n[3 * v], n[3 * v + 1], n[3 * v + 2]) || 1;
  for (let k = 0; k < 3; k++) n[3 * v + k] /= length;
}

// Adds the change of the smooth normals to each target's entries.
function bend(geometry, targets) {
  const { positions, triangles } = geometry;
  const same = welded(positions);
  const count = positions.length / 3;
  const base = new Float32Array(positions.length);
  for (const [a, b, c] of triangles) addNormal(base, positions, a, b, c, [same[a], same[b], same[c]]);
  for (let v = 0; v < count; v++) normalise(base, v);
  const copies = new Map();
  for (let v = 0; v < count; v++) {
    const list = copies.get(same[v]);
    if (list) list.push(v);
    else copies.set(same[v], [v]);
  }
  const around = Array.from({ length: count }, () => []);
  triangles.forEach((t, k) => { for (const v of t) around[same[v]].push(k); });
  const moved = positions.slice();
  for (const target of targets) {
    const touched = new Set();
    const corners = new Set();
    for (const [v, [x, y, z]] of target.entries) {
      moved[3 * v] += x; moved[3 * v + 1] += y; moved[3 * v + 2] += z;
      for (const k of around[same[v]]) touched.add(k);
    }
    for (const k of touched) for (const v of triangles[k]) corners.add(same[v]);
    const all = new Set();
    for (const v of corners) for (const k of around[v]) all.add(k);
    const sums = new Map([...corners].map((v) => [v, [0, 0, 0]]));
    const n = new Float32Array(9);
    for (const k of all) {
      const t = triangles[k];
      n.fill(0);
      addNormal(n, moved, t[0], t[1], t[2], [0]);
      for (const v of t) {
        const sum = sums.get(same[v]);
        if (sum) { sum[0] += n[0]; sum[1] += n[1]; sum[2] += n[2]; }
      }
    }
    for (const [v, sum] of sums) {
      const length = Math.hypot(...sum) || 1;
      const change = sum.map((s, k) => s / length - base[3 * v + k]);
      if (Math.hypot(...change) < NOTHING_NORMAL) continue;
      for (const copy of copies.get(v)) {
        const entry = target.entries.get(copy);
        if (entry) entry.splice(3, 3, ...change);
        else target.entries.set(copy, [0, 0, 0, ...change]);
      }
    }
    for (const v of target.entries.keys()) {
      for (let k = 0; k < 3; k++) moved[3 * v + k] = positions[3 * v + k];
    }
  }
  return base;
}

// `units`: what drives a target whose file does not say, by the target's name in lower case.
export function readGlb(buffer, units) {
  const reader = new Reader(chunks(buffer));
  const { json } = reader;
  const world = places(json);
  const geometry = { positions: [], normals: [], colours: [], uv: [], turns: [], triangles: [], parts: [] };
  const head = headOf(json);
  const targets = [];
  const byName = new Map();
  let hasNormals = true;
  const blocks = new Map();
  for (const [number, matrix] of world) {
    const node = json.nodes[number];
    const mesh = json.meshes?.[node.mesh];
    if (!mesh) continue;
    // A skinned mesh stands where its skeleton puts it, in its bind pose where it is.
    const place = node.skin === undefined ? matrix : json.extensions?.VRM ? rotation([0, 1, 0, 0]) : identity();
    const given = mesh.extras?.targetNames ?? mesh.primitives[0]?.extras?.targetNames ?? [];
    for (const primitive of mesh.primitives) {
      if ((primitive.mode ?? 4) !== 4 || primitive.attributes.POSITION === undefined) continue;
      if (primitive.extensions?.KHR_draco_mesh_compression) throw new Error("compressed geometry; export without Draco");
      const key = JSON.stringify([number, primitive.attributes, primitive.targets]);
      let first = blocks.get(key);
      if (first === undefined) {
        first = geometry.positions.length / 3;
        blocks.set(key, first);
        const position = reader.accessor(primitive.attributes.POSITION);
        const append = (list, values) => { for (const value of values) list.push(value); };
        append(geometry.positions, turned(place, position.values, true));
        const normal = primitive.attributes.NORMAL;
        if (normal === undefined) hasNormals = false;
        append(geometry.normals, normal === undefined ? new Float32Array(position.values.length) : turned(place, reader.accessor(normal).values, false));
        const colour = primitive.attributes.COLOR_0 === undefined ? null : reader.accessor(primitive.attributes.COLOR_0);
        const uv = primitive.attributes.TEXCOORD_0 === undefined ? null : reader.accessor(primitive.attributes.TEXCOORD_0);
        append(geometry.turns, turning(reader, node, primitive, position.count, head));
        for (let v = 0; v < position.count; v++) {
          for (let k = 0; k < 3; k++) geometry.colours.push(colour ? colour.values[v * colour.width + k] : 1);
          for (let k = 0; k < 2; k++) geometry.uv.push(uv ? uv.values[2 * v + k] : 0);
        }
        (primitive.targets ?? []).forEach((wanted, k) => {
          if (wanted.POSITION === undefined) return;
          const name = given[k] ?? `target_${k}`;
          let target = byName.get(name);
          if (!target) {
            const written = mesh.extras?.mien?.units?.[k] ?? units[name.toLowerCase()];
            target = { name, units: [...(written?.split("|") ?? []), name], entries: new Map() };
            byName.set(name, target);
            targets.push(target);
          }
          const a = json.accessors[wanted.POSITION];
          let [rows, values] = [null, null];
          if (a.sparse && a.bufferView === undefined) ({ at: rows, values } = reader.sparse(a, 3));
          else values = reader.accessor(wanted.POSITION).values;
          values = turned(place, values, false);
          for (let j = 0; j * 3 < values.length; j++) {
            const d = [values[3 * j], values[3 * j + 1], values[3 * j + 2]];
            if (Math.abs(d[0]) + Math.abs(d[1]) + Math.abs(d[2]) < NOTHING_M) continue;
            target.entries.set(first + (rows ? rows[j] : j), [...d, 0, 0, 0]);
          }
        });
      }
      const count = reader.json.accessors[primitive.attributes.POSITION].count;
      const indices = primitive.indices === undefined ? Array.from({ length: count }, (_, k) => k) : reader.accessor(primitive.indices).values;
      const part = { material: primitive.material, indices: [] };
      for (let k = 0; k + 2 < indices.length; k += 3) {
        const t = [first + indices[k], first + indices[k + 1], first + indices[k + 2]];
        if (indices[k] >= count || indices[k + 1] >= count || indices[k + 2] >= count) throw new Error("an index is outside the vertices");
        geometry.triangles.push(t);
        part.indices.push(...t);
      }
      geometry.parts.push(part);
    }
  }
  if (!geometry.triangles.length) throw new Error("no triangles in the file");
  geometry.pivot = head === undefined ? null : Array.from(world.get(head)?.slice(12, 15) ?? []);
  if (geometry.pivot?.length !== 3) geometry.pivot = null;
  const smooth = bend(geometry, targets);
  if (!hasNormals) geometry.normals = smooth;
  return { geometry, targets, materials: materials(reader), copyright: json.asset?.copyright ?? "" };
}

// Base colour and, as a promise of an ImageBitmap, base texture.
function materials({ json, bin }) {
  return (json.materials ?? []).map((material) => {
    const look = material.pbrMetallicRoughness ?? {};
    const texture = json.textures?.[look.baseColorTexture?.index];
    const image = json.images?.[texture?.source];
    let bitmap = null;
    if (image?.bufferView !== undefined) {
      const { byteOffset = 0, byteLength } = json.bufferViews[image.bufferView];
      const blob = new Blob([bin.slice(byteOffset, byteOffset + byteLength)], { type: image.mimeType });
      bitmap = createImageBitmap(blob, { colorSpaceConversion: "none" }).catch(() => null);
    }
    return {
      colour: (look.baseColorFactor ?? [1, 1, 1, 1]).slice(0, 3),
      rough: look.roughnessFactor ?? 1,
      doubleSided: material.doubleSided ?? false,
      bitmap,
      wrap: json.samplers?.[texture?.sampler] ?? {},
    };
  });
}

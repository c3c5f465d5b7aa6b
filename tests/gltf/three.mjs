// What three.js sees of baked GLB files: names, and whether all of them carry the same displacements.
// npm install three@0.187.0 && node three.mjs FILE.glb...
globalThis.self = globalThis;
globalThis.ProgressEvent = class {};
import fs from 'fs';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';

async function load(path) {
  const file = fs.readFileSync(path);
  const data = file.buffer.slice(file.byteOffset, file.byteOffset + file.length);
  const gltf = await new GLTFLoader().parseAsync(data, '');
  const meshes = [];
  gltf.scene.traverse((o) => o.isMesh && o.morphTargetDictionary && meshes.push(o));
  return { gltf, meshes };
}

let first;
for (const path of process.argv.slice(2)) {
  const { gltf, meshes } = await load(path);
  const names = Object.keys(meshes[0].morphTargetDictionary);
  let largest = 0, apart = 0;
  const rows = meshes.map((m) => m.geometry.morphAttributes.position.map((a) => a.array));
  rows.forEach((targets, m) => targets.forEach((row, t) => row.forEach((x, k) => {
    largest = Math.max(largest, Math.abs(x));
    if (first) apart = Math.max(apart, Math.abs(x - first[m][t][k]));
  })));
  console.log(`${path}: ${names.length} targets in ${meshes.length} meshes, ${names[0]} to ${names.at(-1)}, ` +
    `relative ${meshes[0].geometry.morphTargetsRelative}, largest ${(largest * 1e3).toFixed(3)} mm, ` +
    `animations ${gltf.animations.length}` + (first ? `, apart from the first ${(apart * 1e6).toFixed(3)} um` : ''));
  first ??= rows;
}

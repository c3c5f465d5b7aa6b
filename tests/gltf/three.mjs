// What three.js sees of a baked GLB: npm install three@0.187.0 && node three.mjs FILE.glb
globalThis.self=globalThis; globalThis.ProgressEvent=class{};
import {GLTFLoader} from 'three/addons/loaders/GLTFLoader.js'; import fs from 'fs';
const b=fs.readFileSync(process.argv[2]); const ab=b.buffer.slice(b.byteOffset,b.byteOffset+b.length);
new GLTFLoader().parse(ab,'',g=>{let m;g.scene.traverse(o=>{if(o.isMesh&&!m)m=o});const d=m.morphTargetDictionary;console.log(Object.keys(d).length,'targets',Object.keys(d).slice(0,3),'relative',m.geometry.morphTargetsRelative,'animations',g.animations.length);const a=m.geometry.morphAttributes.position[d.jawOpen];let mx=0;for(let i=0;i<a.count;i++)mx=Math.max(mx,Math.hypot(a.getX(i),a.getY(i),a.getZ(i)));console.log('jawOpen max m',mx.toFixed(4));},e=>console.log('err',e));

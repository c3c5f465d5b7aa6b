// Draws heads with WebGL 2. Morph targets are applied on the GPU: each vertex has a list of what moves it (target,
// displacement, change of normal), two texels an entry, and reads the weights from a texture of one row. So a frame costs
// the processor one upload of as many floats as there are targets, whatever the size of the mesh.

import { chain, identity, multiply, orbit, perspective, rotation, scaling, translation } from "./matrix.js";

const ROW = 2048; // texels in a row of the texture of entries; even, so that an entry is in one row
const VIEW_ANGLE = 0.5;

const VERTEX = `#version 300 es
precision highp float;
precision highp int;
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 colour;
layout(location = 3) in vec2 uv;
layout(location = 4) in uvec2 list;
layout(location = 5) in float turns;
uniform highp sampler2D entries;
uniform highp sampler2D weights;
uniform mat4 pose;
uniform mat4 view;
uniform mat4 clip;
out vec3 v_normal;
out vec3 v_place;
out vec3 v_colour;
out vec2 v_uv;
void main() {
  vec3 p = position;
  vec3 n = normal;
  for (uint k = 0u; k < list.y; k++) {
    int at = int(list.x + k) * 2;
    vec4 moved = texelFetch(entries, ivec2(at % ${ROW}, at / ${ROW}), 0);
    float w = texelFetch(weights, ivec2(int(moved.w), 0), 0).r;
    if (w != 0.0) {
      p += w * moved.xyz;
      n += w * texelFetch(entries, ivec2(at % ${ROW} + 1, at / ${ROW}), 0).xyz;
    }
  }
  p = mix(p, (pose * vec4(p, 1.0)).xyz, turns);
  n = mix(n, mat3(pose) * n, turns);
  vec4 seen = view * vec4(p, 1.0);
  v_place = seen.xyz;
  v_normal = mat3(view) * n;
  v_colour = colour;
  v_uv = uv;
  gl_Position = clip * seen;
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec3 v_normal;
in vec3 v_place;
in vec3 v_colour;
in vec2 v_uv;
uniform sampler2D picture;
uniform bool pictured;
uniform bool line;
uniform vec3 base;
uniform float rough;
out vec4 drawn;
void main() {
  if (line) { drawn = vec4(base, 1.0); return; }
  vec3 look = base * v_colour * (pictured ? texture(picture, v_uv).rgb : vec3(1.0));
  vec3 n = normalize(v_normal);
  if (!gl_FrontFacing) n = -n;
  vec3 eye = normalize(-v_place);
  vec3 lamp = normalize(vec3(0.35, 0.5, 0.8));
  vec3 fill = normalize(vec3(-0.7, 0.1, 0.4));
  float key = max(dot(n, lamp), 0.0);
  float soft = max(dot(n, fill), 0.0);
  float sky = 0.5 + 0.5 * n.y;
  float shine = pow(max(dot(n, normalize(lamp + eye)), 0.0), mix(60.0, 8.0, rough)) * mix(0.35, 0.03, rough);
  vec3 lit = look * (0.18 + 0.14 * sky + 0.64 * key + 0.18 * soft) + vec3(shine);
  drawn = vec4(pow(clamp(lit, 0.0, 1.0), vec3(1.0 / 2.2)), 1.0);
}`;

function compile(gl) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

function floatTexture(gl, width, height, format, type, data) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, format, width, height, 0, type, gl.FLOAT, data);
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
  return texture;
}

// One head on the GPU.
class Head {
  constructor(gl, name, { geometry, targets, materials }) {
    this.gl = gl;
    this.name = name;
    this.targets = targets;
    this.weights = new Float32Array(Math.max(1, targets.length));
    const count = geometry.positions.length / 3;
    this.vertices = count;
    // Entries, vertex by vertex.
    const sizes = new Uint32Array(count);
    for (const target of targets) for (const v of target.entries.keys()) sizes[v] += 1;
    const lists = new Uint32Array(2 * count);
    let total = 0;
    for (let v = 0; v < count; v++) {
      lists[2 * v] = total;
      total += sizes[v];
    }
    const height = Math.max(1, Math.ceil((2 * total) / ROW));
    if (height > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error("the targets move more vertices than this graphics card supports");
    const data = new Float32Array(ROW * height * 4);
    targets.forEach((target, k) => {
      for (const [v, d] of target.entries) {
        const at = 8 * (lists[2 * v] + lists[2 * v + 1]);
        lists[2 * v + 1] += 1;
        data.set([d[0], d[1], d[2], k, d[3], d[4], d[5], 0], at);
      }
    });
    this.entries = floatTexture(gl, ROW, height, gl.RGBA32F, gl.RGBA, data);
    this.weightTexture = floatTexture(gl, this.weights.length, 1, gl.R32F, gl.RED, this.weights);
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    this.buffers = [];
    const attribute = (at, values, width) => {
      this.buffers.push(gl.createBuffer());
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.at(-1));
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(at);
      if (values instanceof Uint32Array) gl.vertexAttribIPointer(at, width, gl.UNSIGNED_INT, 0, 0);
      else gl.vertexAttribPointer(at, width, gl.FLOAT, false, 0, 0);
    };
    attribute(0, new Float32Array(geometry.positions), 3);
    attribute(1, new Float32Array(geometry.normals), 3);
    attribute(2, new Float32Array(geometry.colours), 3);
    attribute(3, new Float32Array(geometry.uv), 2);
    attribute(4, lists, 2);
    attribute(5, new Float32Array(geometry.turns), 1);
    this.parts = geometry.parts.map((part) => this.part(part, materials[part.material]));
    this.edges = this.wire(geometry.triangles);
    this.frame(geometry.positions, targets);
    this.pivot = geometry.pivot ?? this.centre;
    gl.bindVertexArray(null);
  }

  elements(indices) {
    const { gl } = this;
    const buffer = gl.createBuffer();
    this.buffers.push(buffer);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(indices), gl.STATIC_DRAW);
    return { buffer, count: indices.length };
  }

  // Gives back what it has on the graphics card.
  free() {
    const { gl } = this;
    for (const buffer of this.buffers) gl.deleteBuffer(buffer);
    for (const texture of [this.entries, this.weightTexture, ...this.parts.map((part) => part.texture)]) gl.deleteTexture(texture);
    gl.deleteVertexArray(this.array);
  }

  part({ indices }, material) {
    const { gl } = this;
    const part = { ...this.elements(indices), colour: material?.colour ?? [0.8, 0.72, 0.66], rough: material?.rough ?? 0.7, texture: null };
    material?.bitmap?.then((bitmap) => {
      if (!bitmap) return;
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, material.wrap.wrapS ?? gl.REPEAT);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, material.wrap.wrapT ?? gl.REPEAT);
      part.texture = texture;
    });
    return part;
  }

  wire(triangles) {
    const edges = new Set();
    for (const [a, b, c] of triangles) {
      for (const [p, q] of [[a, b], [b, c], [c, a]]) edges.add(Math.min(p, q) * 2 ** 26 + Math.max(p, q));
    }
    const indices = [];
    for (const edge of edges) indices.push(Math.floor(edge / 2 ** 26), edge % 2 ** 26);
    return this.elements(indices);
  }

  // What is looked at: all that moves, so that of a whole body it is the head.
  frame(positions, targets) {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    const take = (v) => {
      for (let k = 0; k < 3; k++) {
        low[k] = Math.min(low[k], positions[3 * v + k]);
        high[k] = Math.max(high[k], positions[3 * v + k]);
      }
    };
    for (const target of targets) for (const v of target.entries.keys()) take(v);
    if (low[0] > high[0]) for (let v = 0; v < this.vertices; v++) take(v);
    this.centre = low.map((l, k) => (l + high[k]) / 2);
    this.size = Math.max(high[0] - low[0], high[1] - low[1]) || 1;
  }

  // Weights by unit: a target follows the largest of its units, one of its own name among them; what is held by name goes before.
  drive(byUnit, held) {
    this.targets.forEach((target, k) => {
      this.weights[k] = held?.get(target.name) ?? Math.max(0, ...target.units.map((unit) => byUnit.get(unit) ?? 0));
    });
  }

  // How many of its shapes something moves when these units are sent.
  driven(units) {
    return this.targets.filter((target) => target.entries.size && target.units.some((unit) => units.includes(unit))).length;
  }

  draw(program, pose, view, clip, wireframe, ground) {
    const { gl } = this;
    const at = (name) => gl.getUniformLocation(program, name);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.weightTexture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, this.weights.length, 1, gl.RED, gl.FLOAT, this.weights);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.entries);
    gl.activeTexture(gl.TEXTURE2);
    gl.uniform1i(at("entries"), 0);
    gl.uniform1i(at("weights"), 1);
    gl.uniform1i(at("picture"), 2);
    gl.uniformMatrix4fv(at("pose"), false, pose);
    gl.uniformMatrix4fv(at("view"), false, view);
    gl.uniformMatrix4fv(at("clip"), false, clip);
    gl.bindVertexArray(this.array);
    if (wireframe) {
      gl.uniform1i(at("line"), 1);
      // What is behind is hidden by the surface itself, drawn in the colour of the ground.
      gl.uniform3fv(at("base"), ground);
      gl.enable(gl.POLYGON_OFFSET_FILL);
      gl.polygonOffset(1, 1);
      for (const part of this.parts) {
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, part.buffer);
        gl.drawElements(gl.TRIANGLES, part.count, gl.UNSIGNED_INT, 0);
      }
      gl.disable(gl.POLYGON_OFFSET_FILL);
      gl.uniform3fv(at("base"), [0.45, 0.72, 0.95]);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.edges.buffer);
      gl.drawElements(gl.LINES, this.edges.count, gl.UNSIGNED_INT, 0);
    } else {
      gl.uniform1i(at("line"), 0);
      for (const part of this.parts) {
        gl.bindTexture(gl.TEXTURE_2D, part.texture);
        gl.uniform1i(at("pictured"), part.texture ? 1 : 0);
        gl.uniform3fv(at("base"), part.colour);
        gl.uniform1f(at("rough"), part.rough);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, part.buffer);
        gl.drawElements(gl.TRIANGLES, part.count, gl.UNSIGNED_INT, 0);
      }
    }
    gl.bindVertexArray(null);
  }
}

export class View {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("this browser has no WebGL 2");
    this.program = compile(this.gl);
    this.heads = [];
    this.wireframe = false;
    this.mirror = false;
    this.ground = [0, 0, 0];
    // Shapes held by hand, by name.
    this.held = null;
    this.front();
    this.listen();
  }

  front() {
    [this.yaw, this.pitch, this.distance] = [0, 0, 1];
  }

  listen() {
    let from = null;
    this.canvas.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY];
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.yaw -= (event.clientX - from[0]) * 0.008;
      this.pitch = Math.max(-1.5, Math.min(1.5, this.pitch + (event.clientY - from[1]) * 0.008));
      from = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) this.canvas.addEventListener(end, () => { from = null; });
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.distance = Math.max(0.2, Math.min(6, this.distance * Math.exp(event.deltaY * 0.001)));
    }, { passive: false });
  }

  load(name, glb) {
    return new Head(this.gl, name, glb);
  }

  // Draws `columns`, each a head, the weights of its user and, if wanted, their pose. One picture at a time: where a graphics
  // card is slow, buttons would wait behind a queue of them. Says whether one was drawn.
  draw(columns) {
    const { gl, canvas } = this;
    if (this.drawn && !gl.isContextLost()) {
      if (gl.getSyncParameter(this.drawn, gl.SYNC_STATUS) !== gl.SIGNALED) return false;
      gl.deleteSync(this.drawn);
    }
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(...this.ground, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(this.program);
    columns.forEach(({ head, weights, pose }, k) => {
      head.drive(weights, this.held);
      const left = Math.round((width * k) / columns.length);
      const right = Math.round((width * (k + 1)) / columns.length);
      gl.viewport(left, 0, right - left, height);
      const aspect = (right - left) / Math.max(1, height);
      // As far as the head needs, whichever side of the picture is the shorter.
      const far = ((head.size * 1.25) / Math.min(1, aspect) / (2 * Math.tan(VIEW_ANGLE / 2))) * this.distance;
      const view = orbit(this.yaw, this.pitch, far, head.centre);
      let turn = identity();
      if (pose) {
        // The sensor's y points down and z away; here y is up and z towards the viewer.
        const [, , , x, y, z, w] = pose;
        turn = chain(translation(head.pivot), rotation([x, -y, -z, w]), translation(head.pivot.map((c) => -c)));
      }
      let clip = perspective(VIEW_ANGLE, aspect, far * 0.02, far * 20);
      if (this.mirror) clip = multiply(scaling([-1, 1, 1]), clip);
      this.camera = { view, clip };
      gl.frontFace(this.mirror ? gl.CW : gl.CCW);
      head.draw(this.program, turn, view, clip, this.wireframe, this.ground);
    });
    this.drawn = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    return true;
  }
}

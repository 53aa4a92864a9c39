// The 3D view of the report and of the page for makers: WebGL 2, no library, no network.
//
// A mesh: { indices: Uint32Array, positions: Float32Array (3 per vertex), original: the same before the refinement,
// normals, originalNormals (computed if missing), colours: Uint8Array (sRGB, 3 per vertex), uv: Float32Array (2 per
// vertex), relief: Float32Array (-1 to 1), groups: [{ start, count, texture, factor, cutoff }], azimuth: degrees }.

import { VERTEX, FRAGMENT } from "./shaders.js";
import { IDENTITY, back, dot, nearestFace, sub, times, vertexNormals } from "./geometry.js";
import { listen } from "./gestures.js";

export const ONE_COLOUR = 0, TEXTURE = 1, RELIEF = 2, PRINTED = 3;
const FOCAL = 1 / Math.tan((15 * Math.PI) / 180);
const ATTRIBUTES = { refined: 3, original: 3, refinedNormal: 3, originalNormal: 3, colour: 3, paint: 3, uv: 2, relief: 1 };

export class Viewer {
  /** look: material as in the plugin twolight, `plastic` (linear RGB) and `colours` of the relief. options: `eager`, the
   *  wheel zooms without a click; `onFail(code)`: no-webgl, context-lost or refused; `onDraw()` after each picture. */
  constructor(canvas, look, options = {}) {
    this.canvas = canvas;
    this.options = options;
    this.look = look;
    this.state = { shape: 1, surface: ONE_COLOUR, lamp: 0, split: null, turn: IDENTITY, layer: [0, 0.5], brush: [0, 0, 0, 0] };
    this.tool = null;
    this.mesh = null;
    this.ok = this.#start();
    if (this.ok) { listen(this); new ResizeObserver(() => this.redraw()).observe(canvas); }
  }

  #start() {
    const fail = (code) => { this.ok = false; this.options.onFail?.(code); return false; };
    const gl = this.gl = this.canvas.getContext("webgl2", { antialias: true, alpha: true });
    if (!gl) return fail("no-webgl");
    this.canvas.addEventListener("webglcontextlost", () => fail("context-lost"));
    const program = this.program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return fail("refused");
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    const places = new Map();
    this.uniform = (name) => places.get(name) ?? places.set(name, gl.getUniformLocation(program, name)).get(name);
    for (const name of ["albedo", "ambient", "key_weight", "fill_weight", "sharpness"]) gl.uniform1f(this.uniform(name), this.look.material[name]);
    gl.uniform3fv(this.uniform("plastic"), this.look.plastic);
    gl.uniform3fv(this.uniform("scale"), this.look.colours.flatMap((c) => [1, 3, 5].map((i) => parseInt(c.slice(i, i + 2), 16) / 255)));
    return true;
  }

  /** Show a mesh. keep: leave the camera where it is. */
  setMesh(mesh, keep = false) {
    const gl = this.gl, n = mesh.positions.length / 3;
    for (const buffer of this.buffers ?? []) gl.deleteBuffer(buffer);
    for (const texture of this.textures ?? []) gl.deleteTexture(texture);
    this.buffers = [];
    this.mesh = mesh;
    mesh.normals ??= vertexNormals(mesh.positions, mesh.indices);
    if (mesh.original) mesh.originalNormals ??= vertexNormals(mesh.original, mesh.indices);
    this.#attribute("refined", mesh.positions);
    this.#attribute("original", mesh.original ?? mesh.positions);
    this.#attribute("refinedNormal", mesh.normals);
    this.#attribute("originalNormal", mesh.originalNormals ?? mesh.normals);
    this.#attribute("colour", mesh.colours ?? new Uint8Array(3 * n).fill(255));
    this.#attribute("uv", mesh.uv);
    this.#attribute("relief", mesh.relief);
    this.setPaint(null);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers[this.buffers.push(gl.createBuffer()) - 1]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.indices, gl.STATIC_DRAW);
    this.groups = mesh.groups ?? [{ start: 0, count: mesh.indices.length }];
    const made = new Map();
    for (const { texture } of this.groups) if (texture && !made.has(texture)) made.set(texture, this.#texture(texture));
    this.textures = [...made.values()];
    this.textureOf = made;
    this.#measure();
    if (!keep || !this.camera) this.camera = this.#home();
    this.redraw();
  }

  #attribute(name, data) {
    const gl = this.gl, at = gl.getAttribLocation(this.program, name), size = ATTRIBUTES[name];
    if (at < 0) return;
    if (!data) { gl.disableVertexAttribArray(at); gl.vertexAttrib3f(at, 0, 0, 0); return; }
    const buffer = gl.createBuffer(), bytes = data instanceof Uint8Array;
    this.buffers.push(buffer);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, size, bytes ? gl.UNSIGNED_BYTE : gl.FLOAT, bytes, 0, 0);
    return buffer;
  }

  /** What is painted: Uint8Array, 3 per vertex (flat, stronger, matters; 0 or 255); null for nothing. */
  setPaint(paint) {
    const gl = this.gl;
    if (paint && this.paintBuffer) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.paintBuffer);
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, paint);
    } else this.paintBuffer = this.#attribute("paint", paint);
    this.redraw();
  }

  #texture({ image, wrap = [10497, 10497], nearest = false }) {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, wrap[0]);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, wrap[1]);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, nearest ? gl.NEAREST : gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    return texture;
  }

  /** Change what is shown: shape, surface, lamp (degrees), split (share of the width, left of which is the original, or
   *  null), turn (rows of a rotation), layer ([height, bulge]), brush ([x, y, z, radius]). */
  set(changes) {
    const turned = changes.turn && changes.turn.some((x, i) => x !== this.state.turn[i]);
    Object.assign(this.state, changes);
    if (turned && this.mesh) { this.#measure(); this.camera.target = [...this.centre]; }
    this.redraw();
  }

  /** Bounding cylinder about the vertical through the middle of the box: what the view must hold while it turns. */
  #measure() {
    const p = this.mesh.positions, t = this.state.turn, low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    const stands = (i) => [0, 3, 6].map((k) => t[k] * p[i] + t[k + 1] * p[i + 1] + t[k + 2] * p[i + 2]);
    const used = this.mesh.indices;
    for (let f = 0; f < used.length; f++) {
      const q = stands(3 * used[f]);
      for (let k = 0; k < 3; k++) { low[k] = Math.min(low[k], q[k]); high[k] = Math.max(high[k], q[k]); }
    }
    this.extent = sub(high, low);
    this.low = low;
    this.centre = low.map((x, k) => (x + high[k]) / 2);
    this.around = this.radius = 0;
    for (let f = 0; f < used.length; f++) {
      const q = sub(stands(3 * used[f]), this.centre), flat = Math.hypot(q[0], q[2]);
      this.around = Math.max(this.around, flat);
      this.radius = Math.max(this.radius, Math.hypot(flat, q[1]));
    }
  }

  #home() { return { azimuth: (this.mesh.azimuth ?? 0) + 20, elevation: 15, zoom: 1, target: [...this.centre] }; }

  #axes() {
    const a = (this.camera.azimuth * Math.PI) / 180, e = (this.camera.elevation * Math.PI) / 180;
    const towards = [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)];
    const right = [Math.cos(a), 0, -Math.sin(a)];
    const up = [-Math.sin(a) * Math.sin(e), Math.cos(e), -Math.cos(a) * Math.sin(e)];
    return { right, up, towards };
  }

  #distance() {
    const wide = (this.around * this.canvas.clientHeight) / (this.canvas.clientWidth || 1);
    const tall = Math.min(this.radius, this.extent[1] / 2 + 0.26 * this.around);
    return (FOCAL * 1.03 * Math.max(wide, tall) + 0.5 * this.around) / this.camera.zoom;
  }

  redraw() {
    if (this.waiting || !this.mesh) return;
    this.waiting = true;
    requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.waiting = false;
    if (!this.ok || !this.mesh) return;
    const { gl, canvas, state } = this, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.viewport(0, 0, width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { right, up, towards } = this.#axes(), far = this.#distance(), u = this.uniform, axes = [...right, ...up, ...towards];
    gl.uniformMatrix3fv(u("axes"), false, axes);
    gl.uniformMatrix3fv(u("turn"), true, state.turn);
    gl.uniform3fv(u("eye"), this.camera.target.map((x, k) => x + towards[k] * far));
    gl.uniform2f(u("lens"), (FOCAL * height) / width, FOCAL);
    gl.uniform2f(u("depth"), Math.max(far - 2.5 * this.radius, 0.01 * this.radius), far + 2.5 * this.radius);
    gl.uniform3fv(u("up"), times(axes, [0, 1, 0]));
    gl.uniform2fv(u("layer"), state.layer);
    gl.uniform4fv(u("brush"), state.brush);
    gl.uniform1i(u("surface"), state.surface);
    this.#lights({ right, up, towards });
    if (state.split === null) this.#shape(state.shape);
    else {
      const edge = Math.round(state.split * width);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(0, 0, edge, height);
      this.#shape(0);
      gl.scissor(edge, 0, width - edge, height);
      this.#shape(1);
    }
    this.options.onDraw?.();
  }

  #lights({ right, up, towards }) {
    const turn = (this.state.lamp * Math.PI) / 180, { material } = this.look;
    for (const name of ["key", "fill"]) {
      const light = material[name], length = Math.hypot(...light);
      const [x, y, z] = material.lights === "world" ? [right, up, towards].map((axis) => dot(light, axis)) : light;
      this.gl.uniform3f(this.uniform(name), (x * Math.cos(turn) + z * Math.sin(turn)) / length, y / length, (z * Math.cos(turn) - x * Math.sin(turn)) / length);
    }
  }

  #shape(shape) {
    const { gl, uniform: u } = this;
    gl.uniform1f(u("shape"), shape);
    for (const { start, count, texture, factor = [1, 1, 1, 1], cutoff = 0 } of this.groups) {
      gl.uniform1i(u("textured"), texture ? 1 : 0);
      if (texture) gl.bindTexture(gl.TEXTURE_2D, this.textureOf.get(texture));
      gl.uniform4fv(u("factor"), factor);
      gl.uniform1f(u("cutoff"), cutoff);
      gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 4 * start);
    }
  }

  /** Pixels of the page per unit of the mesh, at the middle of the view. */
  get scale() { return (FOCAL * this.canvas.clientHeight) / 2 / this.#distance(); }

  /** What lies under a point of the window: { point, normal, face } in the coordinates of the mesh, or null. */
  pick(clientX, clientY) {
    if (!this.mesh) return null;
    const box = this.canvas.getBoundingClientRect(), { right, up, towards } = this.#axes(), t = this.state.turn;
    const x = ((clientX - box.left) / box.width) * 2 - 1, y = 1 - ((clientY - box.top) / box.height) * 2, wide = box.width / box.height;
    const seen = right.map((_, k) => (x * wide * right[k] + y * up[k]) / FOCAL - towards[k]);
    const eye = back(t, this.camera.target.map((c, k) => c + towards[k] * this.#distance())), ray = back(t, seen);
    const face = nearestFace(this.state.shape < 0.5 && this.mesh.original ? this.mesh.original : this.mesh.positions, this.mesh.indices, eye, ray);
    if (!face) return null;
    return { point: eye.map((e, k) => e + face.distance * ray[k]), normal: face.normal, face: face.index };
  }

  /** Where a point of the mesh is in the canvas, in pixels of the page. */
  project(point) {
    const { right, up, towards } = this.#axes(), far = this.#distance();
    const p = sub(times(this.state.turn, point), this.camera.target), z = far - dot(p, towards), half = this.canvas.clientHeight / 2;
    return [this.canvas.clientWidth / 2 + (FOCAL * half * dot(p, right)) / z, half - (FOCAL * half * dot(p, up)) / z];
  }

  orbit(dx, dy) {
    this.camera.azimuth -= 0.4 * dx;
    this.camera.elevation = Math.max(-89, Math.min(89, this.camera.elevation + 0.4 * dy));
    this.redraw();
  }

  zoom(factor) { this.camera.zoom = Math.max(0.4, Math.min(20, this.camera.zoom * factor)); this.redraw(); }

  shift(dx, dy) {
    const { right, up } = this.#axes(), unit = 1 / this.scale;
    this.camera.target = this.camera.target.map((x, k) => x + unit * (dy * up[k] - dx * right[k]));
    this.redraw();
  }

  reset() { this.camera = this.#home(); this.redraw(); }

  /** Change from one shape to the other, slowly enough to see what moves. */
  morph(goal) {
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) return this.set({ shape: goal });
    const start = performance.now(), from = this.state.shape;
    const step = (now) => {
      const share = Math.max(0, Math.min(1, (now - start) / 300));
      this.state.shape = from + (goal - from) * share;
      this.draw();
      if (share < 1) requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }
}

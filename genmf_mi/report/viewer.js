"use strict";
// The 3D view: unpacks the mesh that packing.py wrote and draws it with WebGL 2. No library, no network.
(async () => {
  const viewer = document.getElementById("viewer");
  const canvas = viewer.querySelector("canvas");
  const message = document.getElementById("viewer-message");
  const fail = (why) => {
    viewer.classList.add("failed");
    viewer.querySelector(".controls").hidden = true;
    message.textContent = why + " The pictures below show the same shapes; the mesh files open in any slicer or 3D viewer.";
  };

  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true });
  if (!gl) return fail("The 3D view needs WebGL 2, which this browser does not offer or has switched off.");
  if (typeof DecompressionStream === "undefined") return fail("The 3D view needs a newer browser (2023 or later).");
  canvas.addEventListener("webglcontextlost", () => fail("The graphics driver stopped the 3D view. Reload the page to see it again."));

  let mesh;
  try {
    mesh = await unpack();
  } catch (error) {
    return fail("The 3D view could not be unpacked (" + error.message + ").");
  }

  async function unpack() {
    const meta = JSON.parse(document.getElementById("mesh-meta").textContent);
    const packed = Uint8Array.from(atob(document.getElementById("mesh-data").textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const n = meta.vertices;
    let at = 0, column = 0;
    const next = (count) => {
      const width = meta.widths[column++], values = new Int32Array(count);
      let sum = 0;
      for (let i = 0; i < count; i++) {
        let folded = 0;
        for (let plane = 0; plane < width; plane++) folded += bytes[at + plane * count + i] * 2 ** (8 * plane);
        sum += folded % 2 ? -(folded + 1) / 2 : folded / 2;
        values[i] = sum;
      }
      at += width * count;
      return values;
    };
    const three = () => [next(n), next(n), next(n)];
    const steps = three();
    const residual = meta.hasOriginal ? three() : [0, 1, 2].map(() => new Int32Array(n));
    const rgb = three();
    const relief = Float32Array.from(next(n), (r) => (r * meta.reliefStep) / meta.rangeMm);
    const indices = new Uint32Array(next(3 * meta.faces));
    const refined = new Float32Array(3 * n), original = new Float32Array(3 * n), colours = new Uint8Array(3 * n);
    for (let i = 0; i < n; i++) {
      for (let k = 0; k < 3; k++) {
        refined[3 * i + k] = meta.low[k] + meta.step * steps[k][i];
        original[3 * i + k] = refined[3 * i + k] + meta.step * residual[k][i];
        colours[3 * i + k] = rgb[k][i];
      }
    }
    return { meta, refined, original, colours, relief, indices };
  }

  /** Vertex normals, weighted by the area of the faces. */
  function normals(p, indices) {
    const n = new Float32Array(p.length);
    for (let f = 0; f < indices.length; f += 3) {
      const a = 3 * indices[f], b = 3 * indices[f + 1], c = 3 * indices[f + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (const i of [a, b, c]) { n[i] += x; n[i + 1] += y; n[i + 2] += z; }
    }
    for (let i = 0; i < n.length; i += 3) {
      const length = Math.hypot(n[i], n[i + 1], n[i + 2]) || 1;
      n[i] /= length; n[i + 1] /= length; n[i + 2] /= length;
    }
    return n;
  }

  const program = gl.createProgram();
  const compile = (type, source) => {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  };
  compile(gl.VERTEX_SHADER, `#version 300 es
    in vec3 refined, original, refinedNormal, originalNormal, colour;
    in float relief;
    uniform mat3 axes;          // rows: right, up, towards the viewer
    uniform vec3 eye;
    uniform vec2 lens;          // focal length over half the width and the height of the picture
    uniform vec2 depth;         // near and far
    uniform float shape;        // 0 original, 1 refined
    out vec3 n, c;
    out float r;
    void main() {
      vec3 p = (mix(original, refined, shape) - eye) * axes;
      n = mix(originalNormal, refinedNormal, shape) * axes;
      c = colour;
      r = relief;
      gl_Position = vec4(lens * p.xy, ((depth.x + depth.y) * p.z + 2.0 * depth.x * depth.y) / (depth.x - depth.y), -p.z);
    }`);
  compile(gl.FRAGMENT_SHADER, `#version 300 es
    precision highp float;
    in vec3 n, c;
    in float r;
    uniform vec3 key, fill;     // towards the lights, in the frame of the camera
    uniform float albedo, ambient, key_weight, fill_weight, sharpness;  // as in the plugin twolight
    uniform int surface;        // 0 one colour, 1 texture, 2 relief
    uniform vec3 scale[9];      // colours of the relief, sRGB
    uniform vec3 plastic;
    out vec4 pixel;
    vec3 linear(vec3 s) { return mix(s / 12.92, pow((s + 0.055) / 1.055, vec3(2.4)), step(0.04045, s)); }
    vec3 srgb(vec3 l) { return mix(l * 12.92, 1.055 * pow(l, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, l)); }
    float softplus(float x) { return max(x, 0.0) + log(1.0 + exp(-abs(x))); }
    float diffuse(float x) { return softplus(sharpness * x) / softplus(sharpness); }
    void main() {
      vec3 m = normalize(n);
      float shade = mix(key_weight * diffuse(dot(m, key)) + fill_weight * diffuse(dot(m, fill)), 1.0, ambient);
      vec3 colour = albedo * (surface == 1 ? linear(c) : plastic);
      if (surface == 2) {
        float at = (clamp(r, -1.0, 1.0) + 1.0) * 4.0;
        int i = int(min(at, 7.0));
        colour = linear(mix(scale[i], scale[i + 1], at - float(i)));
        shade = 0.45 + 0.55 * shade;
      }
      pixel = vec4(srgb(clamp(colour * shade, 0.0, 1.0)), 1.0);
    }`);
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return fail("The graphics driver refused the 3D view.");
  gl.useProgram(program);

  const attribute = (name, data, size, type = gl.FLOAT) => {
    const place = gl.getAttribLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, type, type === gl.UNSIGNED_BYTE, 0, 0);
  };
  attribute("refined", mesh.refined, 3);
  attribute("original", mesh.original, 3);
  attribute("refinedNormal", normals(mesh.refined, mesh.indices), 3);
  attribute("originalNormal", normals(mesh.original, mesh.indices), 3);
  attribute("colour", mesh.colours, 3, gl.UNSIGNED_BYTE);
  attribute("relief", mesh.relief, 1);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.indices, gl.STATIC_DRAW);
  gl.enable(gl.DEPTH_TEST);
  const uniform = (name) => gl.getUniformLocation(program, name);
  const material = mesh.meta.material;
  for (const name of ["albedo", "ambient", "key_weight", "fill_weight", "sharpness"]) gl.uniform1f(uniform(name), material[name]);
  gl.uniform3fv(uniform("plastic"), mesh.meta.plastic);
  gl.uniform3fv(uniform("scale"), mesh.meta.colours.flatMap((c) => [1, 3, 5].map((i) => parseInt(c.slice(i, i + 2), 16) / 255)));

  // Bounding cylinder about the vertical through the middle of the box: what the view must hold while it turns
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  mesh.refined.forEach((x, i) => { low[i % 3] = Math.min(low[i % 3], x); high[i % 3] = Math.max(high[i % 3], x); });
  const centre = low.map((x, k) => (x + high[k]) / 2), half = (high[1] - low[1]) / 2;
  let around = 0, radius = 0;
  for (let i = 0; i < mesh.refined.length; i += 3) {
    const flat = Math.hypot(mesh.refined[i] - centre[0], mesh.refined[i + 2] - centre[2]);
    around = Math.max(around, flat);
    radius = Math.max(radius, Math.hypot(flat, mesh.refined[i + 1] - centre[1]));
  }
  const focal = 1 / Math.tan((15 * Math.PI) / 180);
  const home = () => ({ azimuth: mesh.meta.azimuth + 20, elevation: 15, zoom: 1, target: [...centre] });
  let camera = home(), shape = 1, surface = 0, lamp = 0, waiting = false;

  const axes = () => {
    const a = (camera.azimuth * Math.PI) / 180, e = (camera.elevation * Math.PI) / 180;
    const towards = [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)];
    const right = [Math.cos(a), 0, -Math.sin(a)];
    const up = [-Math.sin(a) * Math.sin(e), Math.cos(e), -Math.cos(a) * Math.sin(e)];
    return { right, up, towards };
  };
  const distance = () => {
    const wide = (around * canvas.clientHeight) / canvas.clientWidth, tall = Math.min(radius, half + 0.26 * around);
    return (focal * 1.03 * Math.max(wide, tall) + 0.5 * around) / camera.zoom;
  };

  function draw() {
    waiting = false;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { right, up, towards } = axes(), far = distance();
    gl.uniformMatrix3fv(uniform("axes"), false, [...right, ...up, ...towards]);
    gl.uniform3fv(uniform("eye"), camera.target.map((x, k) => x + towards[k] * far));
    gl.uniform2f(uniform("lens"), (focal * height) / width, focal);
    gl.uniform2f(uniform("depth"), Math.max(far - 2.5 * radius, 0.01 * radius), far + 2.5 * radius);
    gl.uniform1f(uniform("shape"), shape);
    gl.uniform1i(uniform("surface"), surface);
    const turn = (lamp * Math.PI) / 180;
    for (const name of ["key", "fill"]) {
      const light = material[name], length = Math.hypot(...light);
      const along = (axis) => light.reduce((sum, l, k) => sum + l * axis[k], 0);
      const [x, y, z] = material.lights === "world" ? [right, up, towards].map(along) : light;
      gl.uniform3f(uniform(name), (x * Math.cos(turn) + z * Math.sin(turn)) / length, y / length, (z * Math.cos(turn) - x * Math.sin(turn)) / length);
    }
    gl.drawElements(gl.TRIANGLES, mesh.indices.length, gl.UNSIGNED_INT, 0);
  }
  const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };

  const orbit = (dx, dy) => {
    camera.azimuth -= 0.4 * dx;
    camera.elevation = Math.max(-89, Math.min(89, camera.elevation + 0.4 * dy));
    redraw();
  };
  const zoom = (factor) => { camera.zoom = Math.max(0.4, Math.min(20, camera.zoom * factor)); redraw(); };
  const shift = (dx, dy) => {
    const { right, up } = axes(), unit = (2 * distance()) / focal / canvas.clientHeight;
    camera.target = camera.target.map((x, k) => x + unit * (dy * up[k] - dx * right[k]));
    redraw();
  };
  const reset = () => { camera = home(); redraw(); };

  const pointers = new Map();
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) return;
    const now = [event.clientX, event.clientY], dx = now[0] - last[0], dy = now[1] - last[1];
    const other = [...pointers].find(([id]) => id !== event.pointerId);
    pointers.set(event.pointerId, now);
    if (other) {
      const gap = (p) => Math.hypot(p[0] - other[1][0], p[1] - other[1][1]) || 1;
      zoom(gap(now) / gap(last));
      shift(dx / 2, dy / 2);
    } else if (event.buttons & 2 || event.shiftKey) shift(dx, dy);
    else orbit(dx, dy);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
  // Two fingers belong to the view; one finger that moves up or down scrolls the page (touch-action: pan-y)
  canvas.addEventListener("touchmove", (event) => { if (event.touches.length > 1) event.preventDefault(); }, { passive: false });
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => orbit(-15, 0), ArrowRight: () => orbit(15, 0), ArrowUp: () => orbit(0, 15), ArrowDown: () => orbit(0, -15),
    "+": () => zoom(1.2), "=": () => zoom(1.2), "-": () => zoom(1 / 1.2), 0: reset,
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });

  function morph(goal) {
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) { shape = goal; return redraw(); }
    const start = performance.now(), from = shape;
    const step = (now) => {
      const share = Math.max(0, Math.min(1, (now - start) / 300));
      shape = from + (goal - from) * share;
      draw();
      if (share < 1) requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }
  viewer.addEventListener("input", ({ target }) => {
    if (target.name === "shape") morph(Number(target.value));
    if (target.name === "lamp") { lamp = Number(target.value); redraw(); }
    if (target.name === "surface") {
      surface = Number(target.value);
      document.getElementById("viewer-legend").hidden = surface !== 2;
      redraw();
    }
  });
  const actions = { in: () => zoom(1.25), out: () => zoom(0.8), reset };
  viewer.addEventListener("click", ({ target }) => actions[target.dataset.action]?.());

  new ResizeObserver(redraw).observe(canvas);
  viewer.querySelector(".controls").hidden = false;
  message.textContent = "";
  draw();
})();

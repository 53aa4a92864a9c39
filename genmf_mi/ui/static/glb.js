// Reads a GLB into a mesh for the viewer, so that a dropped model is there before the server has it. What it cannot read
// (compressed geometry, other texture formats) throws, and comes from the server instead.

const TYPES = { 5120: Int8Array, 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
const WIDTHS = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT4: 16 };
const FULL = { 5120: 127, 5121: 255, 5122: 32767, 5123: 65535 };
const KNOWN = ["KHR_texture_transform", "KHR_materials_unlit", "KHR_mesh_quantization"];

/** The mesh in a GLB. Throws if it has anything that this reader does not know. */
export async function readGlb(buffer) {
  const head = new DataView(buffer);
  if (head.getUint32(0, true) !== 0x46546c67 || head.getUint32(4, true) !== 2) throw new Error("no GLB");
  const length = head.getUint32(12, true), text = new TextDecoder().decode(new Uint8Array(buffer, 20, length));
  const tree = JSON.parse(text), start = 20 + length + 8, binary = start <= buffer.byteLength ? buffer.slice(start) : new ArrayBuffer(0);
  const strange = (tree.extensionsRequired ?? []).filter((name) => !KNOWN.includes(name) && !name.startsWith("KHR_materials"));
  if (strange.length) throw new Error(`needs ${strange[0]}`);
  const pieces = [];
  const roots = tree.scenes?.[tree.scene ?? 0]?.nodes ?? (tree.nodes ?? []).map((_, i) => i);
  const visit = (index, parent, depth) => {
    const node = tree.nodes[index], matrix = multiply(parent, local(node));
    if (depth > 100 || node.skin !== undefined) throw new Error("a skeleton or a loop");
    for (const primitive of tree.meshes?.[node.mesh]?.primitives ?? []) pieces.push(piece(tree, binary, primitive, matrix));
    for (const child of node.children ?? []) visit(child, matrix, depth + 1);
  };
  for (const root of roots) visit(root, [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], 0);
  if (!pieces.length) throw new Error("no triangles");
  return joined(pieces, await textures(tree, binary, pieces));
}

function accessor(tree, binary, index) {
  const { bufferView, byteOffset = 0, componentType, count, type, normalized, sparse } = tree.accessors[index];
  if (sparse || bufferView === undefined) throw new Error("a sparse accessor");
  const view = tree.bufferViews[bufferView], Type = TYPES[componentType], width = WIDTHS[type];
  if (view.buffer || view.extensions) throw new Error("another buffer");
  const at = (view.byteOffset ?? 0) + byteOffset, size = Type.BYTES_PER_ELEMENT, stride = view.byteStride ?? width * size;
  let values;
  if (stride === width * size && at % size === 0) values = new Type(binary, at, count * width);
  else {
    values = new Type(count * width);
    const rows = new Uint8Array(values.buffer), bytes = new Uint8Array(binary);
    for (let i = 0; i < count; i++) rows.set(bytes.subarray(at + i * stride, at + i * stride + width * size), i * width * size);
  }
  return { values, width, full: normalized ? FULL[componentType] : 1 };
}

function floats(tree, binary, index) {
  const { values, full } = accessor(tree, binary, index);
  return full === 1 ? Float32Array.from(values) : Float32Array.from(values, (x) => x / full);
}

function piece(tree, binary, primitive, m) {
  if (primitive.extensions || (primitive.mode ?? 4) !== 4) throw new Error("compressed, or no triangles");
  const positions = floats(tree, binary, primitive.attributes.POSITION), n = positions.length / 3;
  for (let i = 0; i < positions.length; i += 3) {
    const [x, y, z] = [positions[i], positions[i + 1], positions[i + 2]];
    for (let k = 0; k < 3; k++) positions[i + k] = m[k] * x + m[k + 4] * y + m[k + 8] * z + m[k + 12];
  }
  let indices = primitive.indices === undefined ? Uint32Array.from({ length: n }, (_, i) => i) : Uint32Array.from(accessor(tree, binary, primitive.indices).values);
  const flipped = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[4] * (m[1] * m[10] - m[2] * m[9]) + m[8] * (m[1] * m[6] - m[2] * m[5]) < 0;
  if (flipped) for (let f = 0; f < indices.length; f += 3) [indices[f], indices[f + 1]] = [indices[f + 1], indices[f]];
  const material = tree.materials?.[primitive.material] ?? {}, surface = material.pbrMetallicRoughness ?? {}, base = surface.baseColorTexture;
  if (material.extensions?.KHR_materials_pbrSpecularGlossiness && !base) throw new Error("another kind of material");
  const set = base?.extensions?.KHR_texture_transform?.texCoord ?? base?.texCoord ?? 0, uv = primitive.attributes[`TEXCOORD_${set}`];
  const colour = primitive.attributes.COLOR_0;
  return {
    positions, indices, texture: base && uv !== undefined ? base.index : null,
    uv: base && uv !== undefined ? moved(floats(tree, binary, uv), base.extensions?.KHR_texture_transform) : new Float32Array(2 * n),
    colours: colour === undefined ? new Uint8Array(3 * n).fill(255) : encoded(accessor(tree, binary, colour), n),
    factor: surface.baseColorFactor ?? [1, 1, 1, 1],
    cutoff: material.alphaMode === "MASK" ? material.alphaCutoff ?? 0.5 : material.alphaMode === "BLEND" ? 0.1 : 0,
  };
}

function moved(uv, { offset = [0, 0], scale = [1, 1], rotation = 0 } = {}) {
  const c = Math.cos(rotation), s = Math.sin(rotation);
  for (let i = 0; i < uv.length; i += 2) {
    const u = uv[i] * scale[0], v = uv[i + 1] * scale[1];
    uv[i] = c * u + s * v + offset[0];
    uv[i + 1] = -s * u + c * v + offset[1];
  }
  return uv;
}

/** Linear colours of a file as sRGB bytes. */
function encoded({ values, width, full }, n) {
  const colours = new Uint8Array(3 * n), table = Uint8Array.from({ length: 4096 }, (_, i) => {
    const x = i / 4095;
    return Math.round(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055));
  });
  for (let i = 0; i < n; i++)
    for (let k = 0; k < 3; k++) colours[3 * i + k] = table[Math.round(4095 * Math.min(1, Math.max(0, values[width * i + k] / full)))];
  return colours;
}

async function textures(tree, binary, pieces) {
  const made = new Map();
  for (const { texture } of pieces) {
    if (texture === null || made.has(texture)) continue;
    const { source, sampler } = tree.textures[texture], image = tree.images[source], rules = tree.samplers?.[sampler] ?? {};
    if (image?.bufferView === undefined) throw new Error("a texture of another kind");
    const view = tree.bufferViews[image.bufferView], bytes = new Uint8Array(binary, view.byteOffset ?? 0, view.byteLength);
    const options = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
    const bitmap = await createImageBitmap(new Blob([bytes], { type: image.mimeType }), options);
    made.set(texture, { image: bitmap, wrap: [rules.wrapS ?? 10497, rules.wrapT ?? 10497], nearest: rules.magFilter === 9728 });
  }
  return made;
}

function joined(pieces, made) {
  const all = (name, Type) => {
    const result = new Type(pieces.reduce((sum, each) => sum + each[name].length, 0));
    let at = 0;
    for (const each of pieces) { result.set(each[name], at); at += each[name].length; }
    return result;
  };
  let vertices = 0, start = 0;
  const groups = pieces.map(({ positions, indices, texture, factor, cutoff }) => {
    for (let i = 0; i < indices.length; i++) indices[i] += vertices;
    vertices += positions.length / 3;
    const group = { start, count: indices.length, texture: made.get(texture), factor, cutoff };
    start += indices.length;
    return group;
  });
  const mesh = { positions: all("positions", Float32Array), indices: all("indices", Uint32Array), colours: all("colours", Uint8Array), groups };
  if (pieces.some((each) => each.texture !== null)) mesh.uv = all("uv", Float32Array);
  for (const index of mesh.indices) if (index >= vertices) throw new Error("an index beyond the vertices");
  return mesh;
}

function local({ matrix, translation: t = [0, 0, 0], rotation: [x, y, z, w] = [0, 0, 0, 1], scale: s = [1, 1, 1] }) {
  if (matrix) return matrix;
  return [
    s[0] * (1 - 2 * (y * y + z * z)), s[0] * 2 * (x * y + z * w), s[0] * 2 * (x * z - y * w), 0,
    s[1] * 2 * (x * y - z * w), s[1] * (1 - 2 * (x * x + z * z)), s[1] * 2 * (y * z + x * w), 0,
    s[2] * 2 * (x * z + y * w), s[2] * 2 * (y * z - x * w), s[2] * (1 - 2 * (x * x + y * y)), 0, ...t, 1,
  ];
}

function multiply(a, b) {
  const c = new Array(16).fill(0);
  for (let column = 0; column < 4; column++)
    for (let row = 0; row < 4; row++)
      for (let k = 0; k < 4; k++) c[4 * column + row] += a[4 * k + row] * b[4 * column + k];
  return c;
}

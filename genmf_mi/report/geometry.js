// Vectors, normals, and rays that meet a mesh. Positions are flat arrays, three numbers per vertex.

export const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** Matrices are rows; `times` applies one, `back` its transpose. */
export const times = (m, v) => [0, 3, 6].map((i) => m[i] * v[0] + m[i + 1] * v[1] + m[i + 2] * v[2]);
export const back = (m, v) => [0, 1, 2].map((i) => m[i] * v[0] + m[i + 3] * v[1] + m[i + 6] * v[2]);

/** Vertex normals, weighted by the area of the faces; vertices in one place share theirs, so that seams do not show. */
export function vertexNormals(p, indices) {
  const count = p.length / 3, first = sameplace(p), n = new Float32Array(p.length);
  for (let f = 0; f < indices.length; f += 3) {
    const a = 3 * first[indices[f]], b = 3 * first[indices[f + 1]], c = 3 * first[indices[f + 2]];
    const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
    const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    n[a] += x; n[a + 1] += y; n[a + 2] += z;
    n[b] += x; n[b + 1] += y; n[b + 2] += z;
    n[c] += x; n[c + 1] += y; n[c + 2] += z;
  }
  for (let v = 0; v < count; v++) {
    const i = 3 * v, j = 3 * first[v];
    if (i !== j) { n[i] = n[j]; n[i + 1] = n[j + 1]; n[i + 2] = n[j + 2]; continue; }
    const length = Math.hypot(n[i], n[i + 1], n[i + 2]) || 1;
    n[i] /= length; n[i + 1] /= length; n[i + 2] /= length;
  }
  return n;
}

/** For each vertex the first one that lies in the same place. */
function sameplace(p) {
  const count = p.length / 3, bits = new Int32Array(Float32Array.from(p, (x) => x + 0).buffer), first = new Uint32Array(count);
  let size = 4;
  while (size < 2 * count) size *= 2;
  const table = new Int32Array(size).fill(-1);
  for (let v = 0; v < count; v++) {
    const x = bits[3 * v], y = bits[3 * v + 1], z = bits[3 * v + 2];
    let slot = (Math.imul(x, 73856093) ^ Math.imul(y, 19349663) ^ Math.imul(z, 83492791));
    slot = (slot ^ (slot >>> 15)) & (size - 1);
    for (; ; slot = (slot + 1) & (size - 1)) {
      const u = table[slot];
      if (u < 0) { table[slot] = first[v] = v; break; }
      if (bits[3 * u] === x && bits[3 * u + 1] === y && bits[3 * u + 2] === z) { first[v] = u; break; }
    }
  }
  return first;
}

/** The first face that a ray meets from its front or its back: { index, distance, normal }, or null. */
export function nearestFace(p, indices, eye, ray) {
  let best = Infinity, found = -1;
  for (let f = 0; f < indices.length; f += 3) {
    const a = 3 * indices[f], b = 3 * indices[f + 1], c = 3 * indices[f + 2];
    const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
    const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
    const hx = ray[1] * vz - ray[2] * vy, hy = ray[2] * vx - ray[0] * vz, hz = ray[0] * vy - ray[1] * vx;
    const det = ux * hx + uy * hy + uz * hz;
    if (det === 0) continue;
    const sx = eye[0] - p[a], sy = eye[1] - p[a + 1], sz = eye[2] - p[a + 2], s = (sx * hx + sy * hy + sz * hz) / det;
    if (s < 0 || s > 1) continue;
    const qx = sy * uz - sz * uy, qy = sz * ux - sx * uz, qz = sx * uy - sy * ux, t = (ray[0] * qx + ray[1] * qy + ray[2] * qz) / det;
    if (t < 0 || s + t > 1) continue;
    const distance = (vx * qx + vy * qy + vz * qz) / det;
    if (distance > 0 && distance < best) { best = distance; found = f; }
  }
  if (found < 0) return null;
  const corner = (k) => [0, 1, 2].map((i) => p[3 * indices[found + k] + i]);
  const n = cross(sub(corner(1), corner(0)), sub(corner(2), corner(0))), length = Math.hypot(...n) || 1;
  return { index: found / 3, distance: best, normal: n.map((x) => x / length) };
}

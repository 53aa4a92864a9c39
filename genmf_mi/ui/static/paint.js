// Regions painted on the model: strokes of a round brush, kept in the coordinates of the file, in mm on the part.
import { vertexNormals } from "/geometry.js";

export const KINDS = ["flat", "stronger", "matters", "erase"];
const AGREES = 0; // a vertex belongs to a stroke if its normal points to the same side
const MAX_FACES = 150_000;

/** The mesh in smaller triangles, so that the edge of what is painted is as round as the brush. */
export function finer(mesh, longest) {
  let edge = longest / 70, result = mesh;
  for (let round = 0; round < 6; round++) {
    const next = halved(result, edge);
    if (next === result) { result.edge = edge; break; }
    if (next.indices.length / 3 > MAX_FACES) break;
    result = next;
    result.edge = edge;
  }
  return result;
}

/** Every edge longer than `edge` halved; faces on both sides agree, as they see the same edge. */
function halved(mesh, edge) {
  const { positions: p, indices, uv, colours } = mesh, middles = new Map(), sources = [];
  const n = p.length / 3, limit = edge * edge;
  const long = (a, b) => (p[3 * a] - p[3 * b]) ** 2 + (p[3 * a + 1] - p[3 * b + 1]) ** 2 + (p[3 * a + 2] - p[3 * b + 2]) ** 2 > limit;
  const middle = (a, b) => {
    const key = a < b ? a * n + b : b * n + a;
    let found = middles.get(key);
    if (found === undefined) { found = n + sources.length; sources.push([a, b]); middles.set(key, found); }
    return found;
  };
  const faces = [], groups = [];
  for (const group of mesh.groups ?? [{ start: 0, count: indices.length }]) {
    const start = faces.length;
    for (let f = group.start; f < group.start + group.count; f += 3) {
      let [a, b, c] = [indices[f], indices[f + 1], indices[f + 2]], cuts = [long(a, b), long(b, c), long(c, a)];
      const count = cuts.filter(Boolean).length;
      while (count === 1 ? !cuts[0] : count === 2 && cuts[2]) { [a, b, c] = [b, c, a]; cuts = [cuts[1], cuts[2], cuts[0]]; }
      if (count === 0) faces.push(a, b, c);
      else if (count === 1) { const m = middle(a, b); faces.push(a, m, c, m, b, c); }
      else if (count === 2) { const m = middle(a, b), o = middle(b, c); faces.push(a, m, c, m, o, c, m, b, o); }
      else { const m = middle(a, b), o = middle(b, c), q = middle(c, a); faces.push(a, m, q, m, b, o, q, o, c, m, o, q); }
    }
    groups.push({ ...group, start, count: faces.length - start });
  }
  if (!sources.length) return mesh;
  const grown = (values, width, Type) => {
    if (!values) return undefined;
    const result = new Type(values.length + width * sources.length);
    result.set(values);
    sources.forEach(([a, b], i) => { for (let k = 0; k < width; k++) result[values.length + width * i + k] = (values[width * a + k] + values[width * b + k]) / 2; });
    return result;
  };
  return {
    azimuth: mesh.azimuth, positions: grown(p, 3, Float32Array), uv: grown(uv, 2, Float32Array), colours: grown(colours, 3, Uint8Array),
    normals: grown(mesh.normals, 3, Float32Array), indices: Uint32Array.from(faces), groups,
  };
}

/** The brush as a tool of a viewer. `mm` is how many millimetres a unit of the file is on the part. */
export class Painter {
  constructor(viewer, { onChange }) {
    this.viewer = viewer;
    this.onChange = onChange;
    this.strokes = [];
    this.kind = null;
    this.radius = 4;
    this.factor = 2;
    this.mm = 1;
    this.active = false;
  }

  /** Paint on another mesh of the same model, and show what is painted already. */
  use(mesh) {
    this.mesh = mesh;
    this.normals = mesh.normals ?? vertexNormals(mesh.positions, mesh.indices);
    this.refresh();
  }

  get regions() { return { format: "genmf-regions", version: 1, strokes: this.strokes }; }

  load(regions) { this.strokes = regions?.strokes ?? []; this.refresh(); }

  undo() { this.strokes.pop(); this.refresh(); this.onChange(); }

  clear() { this.strokes = []; this.refresh(); this.onChange(); }

  /** Which of flat, stronger, matters every vertex is, from all strokes. */
  refresh() {
    if (!this.mesh) return;
    this.paint = new Uint8Array(this.mesh.positions.length);
    for (const stroke of this.strokes) this.#apply(stroke, 0);
    this.viewer.setPaint(this.strokes.length ? this.paint : null);
  }

  /** Mark the vertices within the brush along a stroke from its point `from` on. */
  #apply(stroke, from) {
    const { paint, normals: n } = this, p = this.mesh.positions, r = stroke.radius_mm / this.mm, soft = this.mesh.edge ?? r / 4;
    const channel = KINDS.indexOf(stroke.kind);
    for (let s = Math.max(0, from - 1); s < Math.max(1, stroke.points.length - 1); s++) {
      const a = stroke.points[s], b = stroke.points[s + 1] ?? a, m = stroke.normals[s + 1] ?? stroke.normals[s];
      const d = [b[0] - a[0], b[1] - a[1], b[2] - a[2]], length = d[0] ** 2 + d[1] ** 2 + d[2] ** 2 || 1;
      for (let i = 0; i < p.length; i += 3) {
        const x = p[i] - a[0], y = p[i + 1] - a[1], z = p[i + 2] - a[2];
        const t = Math.min(1, Math.max(0, (x * d[0] + y * d[1] + z * d[2]) / length));
        const away = (x - t * d[0]) ** 2 + (y - t * d[1]) ** 2 + (z - t * d[2]) ** 2;
        if (away > (r + soft) ** 2 || n[i] * m[0] + n[i + 1] * m[1] + n[i + 2] * m[2] <= AGREES) continue;
        // The border runs where the value is a half, between the vertices
        const value = Math.round(255 * Math.min(1, Math.max(0, 0.5 + (r - Math.sqrt(away)) / (2 * soft))));
        for (let k = 0; k < 3; k++) paint[i + k] = k === channel ? Math.max(paint[i + k], value) : Math.min(paint[i + k], 255 - value);
      }
    }
  }

  down(event) {
    const hit = this.#hit(event);
    if (!hit) return;
    this.active = true;
    const stroke = { kind: this.kind, points: [], normals: [], radius_mm: this.radius };
    if (this.kind === "stronger") stroke.factor = this.factor;
    this.strokes.push(stroke);
    this.#add(hit);
  }

  move(event) {
    const hit = this.#hit(event), last = this.strokes.at(-1)?.points.at(-1);
    if (!hit || !last) return;
    const gap = Math.hypot(...hit.point.map((x, k) => x - last[k])) * this.mm;
    if (gap > this.radius / 5) this.#add(hit);
    this.#ring(hit);
  }

  up() {
    if (!this.active) return;
    this.active = false;
    this.onChange();
  }

  /** A second finger came: what the first has begun was no stroke. */
  cancel() {
    if (!this.active) return;
    this.active = false;
    if (this.strokes.at(-1).points.length < 4) this.strokes.pop();
    this.refresh();
    this.onChange();
  }

  hover(event) { this.#ring(event.pointerType === "touch" ? null : this.#hit(event)); }

  leave() { this.#ring(null); }

  #hit({ clientX, clientY }) { return this.viewer.pick(clientX, clientY); }

  #ring(hit) { this.viewer.set({ brush: hit ? [...hit.point, this.radius / this.mm] : [0, 0, 0, 0] }); }

  #add({ point, normal }) {
    const stroke = this.strokes.at(-1), round = (x) => Number(x.toPrecision(7));
    stroke.points.push(point.map(round));
    stroke.normals.push(normal.map((x) => Number(x.toFixed(4))));
    this.#apply(stroke, stroke.points.length - 1);
    this.viewer.setPaint(this.paint);
  }
}

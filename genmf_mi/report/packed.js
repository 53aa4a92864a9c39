// Undoes packing.py: a mesh as a report holds it, made ready for the viewer.

/** meta: what packing.py says of it. text: base64 of the deflated columns. */
export async function unpack(meta, text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
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
  const positions = new Float32Array(3 * n), original = new Float32Array(3 * n), colours = new Uint8Array(3 * n);
  for (let i = 0; i < n; i++) {
    for (let k = 0; k < 3; k++) {
      positions[3 * i + k] = meta.low[k] + meta.step * steps[k][i];
      original[3 * i + k] = positions[3 * i + k] + meta.step * residual[k][i];
      colours[3 * i + k] = rgb[k][i];
    }
  }
  return { positions, original, colours, relief, indices, azimuth: meta.azimuth };
}

// What came out: before and after in 3D, the files, what to open them with.
import { fileUrl } from "/api.js";
import { clock } from "/running.js";
import { unpack } from "/packed.js";
import { el, number, t } from "/texts.js";

/** Elsewhere a slicer would need the token. */
const LOCAL = ["127.0.0.1", "localhost", "[::1]"].includes(location.hostname);

export class Result {
  constructor(card, viewer) { this.card = card; this.viewer = viewer; this.reset(); }

  reset() { this.seen = false; this.mm = 1; this.up = [0, 1, 0]; this.metrics = null; this.job = null; }

  /** The meshes as the report of the run holds them, and the numbers. */
  async open(job) {
    const [page, metrics] = await Promise.all([fetch(fileUrl(job, "report.html")).then((r) => r.text()), fetch(fileUrl(job, "metrics.json")).then((r) => r.json())]);
    // Not parsed as HTML, whose styles the policy of this page would refuse
    const part = (id) => page.match(new RegExp(`id="${id}">([^<]*)</script>`))[1];
    const meta = JSON.parse(part("mesh-meta")), mesh = await unpack(meta, part("mesh-data"));
    this.cap = meta.rangeMm;
    this.up = metrics.stand?.up ?? [0, 1, 0];
    this.metrics = metrics;
    this.viewer.setMesh(mesh);
    // The mesh is in the normalised frame, whose longest side is 2 × 0.95
    this.mm = this.size / 1.9;
    this.render(job);
  }

  render(job) {
    this.job = job;
    const link = (name, kind, words, note) => el("a", { class: kind, href: fileUrl(job, name, true), download: "" }, words, note ? el("small", {}, note) : "");
    this.card.replaceChildren(
      el("h2", { role: "status" }, job.kept ? t("result.kept") : t("result.done")),
      ...(this.metrics ? [this.#facts()] : []),
      el("div", { class: "downloads" },
        link("refined.3mf", "main", t("result.3mf"), t("result.3mf-note")),
        link("refined.stl", "quiet", "STL", t("result.stl-note")), link("refined.glb", "quiet", "GLB", t("result.glb-note")),
        el("a", { class: "quiet", href: fileUrl(job, "report.html"), target: "_blank", rel: "noopener" }, t("result.report"), el("small", {}, t("result.report-note"))),
        link("before_after.png", "quiet", t("result.picture"), "PNG")),
      ...(LOCAL ? [el("p", { class: "links" }, el("span", {}, t("result.open-in")), ...slicers(new URL(fileUrl(job, "refined.3mf"), location.href).href).map(([name, href]) => el("a", { href }, name)))] : []),
    );
  }

  #facts() {
    const { relief_mm: relief, before, after, solid, seconds } = this.metrics, better = Math.round(100 * (1 - after.lpips_alex / before.lpips_alex));
    const rows = [
      [t("fact.relief"), t("fact.relief-value", { max: number(relief.max, 2), mean: number(relief.mean, 2) })],
      [t("fact.likeness"), better > 0 ? t("fact.likeness-better", { percent: better }) : t("fact.likeness-same")],
      [t("fact.solid"), solid.watertight ? t("fact.solid-yes") : t("fact.solid-no")],
      [t("fact.time"), clock(seconds.total)],
    ];
    return el("dl", { class: "facts" }, ...rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
  }
}

/** Slicers that fetch a file from any address. PrusaSlicer takes files of a few sites only, so it has no link. */
function slicers(url) {
  const file = encodeURIComponent(url), mac = /Mac/.test(navigator.platform);
  return [["OrcaSlicer", `orcaslicer://open?file=${file}`], ["Bambu Studio", mac ? `bambustudioopen://${file}` : `bambustudio://open?file=${file}`]];
}

// The card with the brushes.
import { KINDS, Painter, finer } from "/paint.js";
import { el, number, t } from "/texts.js";

export class Paint {
  constructor(card, viewer, onChange) {
    this.card = card;
    this.viewer = viewer;
    this.turn = null;
    this.painter = new Painter(viewer, { onChange: () => { this.#count(); onChange(); } });
  }

  /** Null if nothing is painted. */
  get regions() { return this.painter.strokes.length ? this.painter.regions : null; }

  /** turn: rows of the rotation from the file to the frame that the strokes are in. */
  load(regions, turn) { this.turn = turn ?? null; this.painter.mesh = null; this.painter.load(regions); this.stop(); this.draw(); }

  /** Paint on a mesh; strokes turn with it if it was read with another axis upwards. */
  use(mesh, { turn, model }, size) {
    const now = turn ?? null;
    if (this.turn && now && this.turn.some((x, i) => x !== now[i])) this.#turned(this.turn, now);
    this.turn = now;
    this.size = size;
    this.longest = Math.max(...model.extent);
    this.coarse = mesh;
    this.fine = null;
    if (this.painter.strokes.length) this.#fine();
  }

  rescale(mm) {
    if (this.painter.mm === mm) return;
    this.painter.mm = mm;
    if (this.painter.strokes.length) this.painter.refresh();
  }

  #fine() {
    if (this.fine || !this.coarse) return;
    this.fine = finer(this.coarse, this.longest);
    if (this.viewer.mesh === this.coarse) this.viewer.setMesh(this.fine, true);
    this.painter.use(this.fine);
  }

  #turned(from, to) {
    const back = (v) => [0, 1, 2].map((i) => from[i] * v[0] + from[i + 3] * v[1] + from[i + 6] * v[2]);
    const on = (v) => [0, 3, 6].map((i) => to[i] * v[0] + to[i + 1] * v[1] + to[i + 2] * v[2]);
    for (const stroke of this.painter.strokes) for (const name of ["points", "normals"]) stroke[name] = stroke[name].map((v) => on(back(v)));
  }

  pick(kind) {
    this.painter.kind = kind || null;
    this.viewer.tool = kind ? this.painter : null;
    document.body.classList.toggle("painting", Boolean(kind));
    if (kind) this.#fine(); else this.painter.leave();
    for (const button of this.card.querySelectorAll("[data-kind]")) button.setAttribute("aria-pressed", String(button.dataset.kind === (kind || "")));
    this.card.querySelector("#paint-more").hidden = !kind;
    this.card.querySelector("#paint-factor").hidden = kind !== "stronger";
  }

  stop() { if (this.viewer.tool) this.pick(null); }

  undo() { if (this.painter.strokes.length) this.painter.undo(); }

  draw() {
    const kind = this.painter.kind, range = (id, key, [min, max, step], value, unit, set) => {
      const shown = el("output", { class: "unit" }, `${number(value)} ${unit}`), input = el("input", { type: "range", id, min, max, step, value });
      input.addEventListener("input", () => { set(Number(input.value)); shown.textContent = `${number(Number(input.value))} ${unit}`; });
      return el("div", { class: "field" }, el("label", { for: id }, t(key)), el("div", { class: "pair" }, input, shown));
    };
    const factor = range("factor", "paint.factor", [1.2, 4, 0.1], this.painter.factor, "×", (x) => { this.painter.factor = x; });
    factor.id = "paint-factor";
    this.card.replaceChildren(
      el("h2", {}, t("paint.title")),
      el("p", { class: "help" }, t("paint.help")),
      el("div", { class: "tools", role: "group", "aria-label": t("paint.title") }, ...["", ...KINDS].map((name) => el("button", {
        type: "button", "data-kind": name, "aria-pressed": String((kind ?? "") === name), onclick: () => this.pick(name),
      }, t(`paint.${name || "turn"}`)))),
      el("div", { id: "paint-more", hidden: !kind }, range("brush", "paint.size", [1, 20, 0.5], this.painter.radius * 2, "mm", (x) => { this.painter.radius = x / 2; }), factor),
      el("div", { class: "row" },
        el("button", { type: "button", class: "small", id: "paint-undo", onclick: () => this.undo() }, t("paint.undo")),
        el("button", { type: "button", class: "small", id: "paint-clear", onclick: () => this.painter.clear() }, t("paint.clear"))),
    );
    this.card.querySelector("#paint-factor").hidden = kind !== "stronger";
    this.#count();
  }

  #count() {
    for (const id of ["paint-undo", "paint-clear"]) { const b = this.card.querySelector(`#${id}`); if (b) b.disabled = !this.painter.strokes.length; }
  }
}

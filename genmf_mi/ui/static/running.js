// How far a job is: the picture so far, the loss, the time left.
import { fileUrl } from "/api.js";
import { el, has, number, plural, t } from "/texts.js";

export class Progress {
  constructor(card) { this.card = card; this.reset(); }

  reset() { this.losses = []; this.stage = ""; this.pace = null; this.done = this.total = 0; this.warnings = []; this.card.replaceChildren(); this.job = null; }

  /** Lines of `genmf-mi refine --json-progress`. */
  add(lines) {
    for (const { at, stage, done, total, values, warning } of lines) {
      if (stage !== undefined) { this.stage = stage; this.done = this.total = 0; this.pace = null; }
      if (warning !== undefined) this.warnings.push(warning);
      if (done === undefined) continue;
      if (!this.pace || done < this.pace.done || total !== this.total) this.pace = { at, done };
      [this.done, this.total, this.at] = [done, total, at];
      if (values?.loss !== undefined) this.losses[Math.round(done)] = values.loss;
    }
    if (this.job) this.draw();
  }

  get left() {
    if (!this.pace || this.done <= this.pace.done) return null;
    return ((this.at - this.pace.at) * (this.total - this.done)) / (this.done - this.pace.done);
  }

  render(job, jobs) { this.job = job; this.before = jobs.filter((each) => each.state === "running" || (each.state === "queued" && each.queued < job.queued)).length; this.draw(); }

  draw() {
    const { job } = this, waiting = job.state === "queued", share = this.total ? this.done / this.total : null;
    if (!this.card.firstChild) {
      this.title = el("h2", { role: "status" });
      this.fill = el("i");
      this.bar = el("div", { class: "progressbar", role: "progressbar", "aria-valuemin": 0, "aria-valuemax": 100 }, this.fill);
      this.count = el("span");
      this.time = el("span");
      this.image = el("img", { alt: "" });
      this.picture = el("div", { class: "picture", hidden: true }, this.image);
      this.curve = curve();
      this.notes = el("ul", { class: "findings" });
      this.card.replaceChildren(this.title, this.bar, el("div", { class: "numbers" }, this.count, this.time), this.picture, this.curve.svg, this.notes);
    }
    const words = job.cancelling ? t("run.cancelling") : job.stopping ? t("run.stopping") : waiting ? plural("run.waiting", this.before) : stageName(this.stage);
    if (this.title.textContent !== words) this.title.textContent = words;
    this.bar.setAttribute("aria-label", words);
    this.bar.classList.toggle("busy", share === null && !waiting);
    this.fill.style.width = share === null ? "" : `${100 * share}%`;
    if (share === null) this.bar.removeAttribute("aria-valuenow"); else this.bar.setAttribute("aria-valuenow", String(Math.round(100 * share)));
    this.count.textContent = this.total > 1 ? t("run.step", { done: number(this.done, 0), total: number(this.total, 0) }) : "";
    this.time.textContent = this.left === null ? "" : t("run.left", { time: clock(this.left) });
    if (job.preview && job.preview !== this.shown) { this.shown = job.preview; this.image.src = `${fileUrl(job, "preview.png")}?${job.preview}`; this.image.alt = t("run.picture"); this.picture.hidden = false; }
    if (!job.preview) this.picture.hidden = true;
    this.curve.draw(this.losses, this.total);
    this.notes.replaceChildren(...this.warnings.map((text) => el("li", { class: "warning" }, el("span", {}, text))));
  }
}

const stageName = (stage) => {
  const key = `stage.${stage.split(":")[0].split(",")[0]}`;
  return has(key) ? t(key) : stage ? stage[0].toUpperCase() + stage.slice(1) : t("run.starting");
};

export const clock = (seconds) => (seconds < 90 ? t("time.seconds", { count: Math.max(1, Math.round(seconds)) }) : t("time.minutes", { count: Math.round(seconds / 60) }));

/** The loss over the iterations: each value, and the running median. */
function curve() {
  const make = (name, attributes) => { const e = document.createElementNS("http://www.w3.org/2000/svg", name); for (const [k, v] of Object.entries(attributes)) e.setAttribute(k, v); return e; };
  const svg = make("svg", { class: "curve", viewBox: "0 0 100 100", preserveAspectRatio: "none", role: "img" }), raw = make("path", { class: "raw" }), smooth = make("path", {});
  svg.append(raw, smooth);
  const line = (points) => points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(2)} ${y.toFixed(2)}`).join("");
  const draw = (losses, total) => {
    const known = losses.map((loss, i) => [i, loss]).filter(([, loss]) => Number.isFinite(loss));
    svg.toggleAttribute("hidden", known.length < 3);
    svg.setAttribute("aria-label", t("run.curve"));
    if (known.length < 3) return;
    const values = known.map(([, loss]) => loss), low = Math.min(...values), high = Math.max(...values);
    const place = ([i, loss]) => [(100 * i) / (total > 1 ? total : known.at(-1)[0]), 96 - (92 * (loss - low)) / (high - low || 1)];
    const median = (k) => { const near = values.slice(Math.max(0, k - 4), k + 5).sort((a, b) => a - b); return near[near.length >> 1]; };
    raw.setAttribute("d", line(known.map(place)));
    smooth.setAttribute("d", line(known.map(([i], k) => place([i, median(k)]))));
  };
  return { svg, draw };
}

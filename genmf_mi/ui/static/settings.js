// The settings that a job is asked for; choices, defaults and English help come from the server.
import { el, has, language, number, t } from "/texts.js";

const RANGES = { size_mm: [20, 250, 1], max_relief_mm: [0.2, 3, 0.1], nozzle_mm: [0.2, 1, 0.05] };
const FIRST = ["size_mm", "printer", "max_relief_mm", "stand"];
const SIDES = { upright: 0, "upside-down": 180, "on-back": -90, "on-front": 90, "on-left": -90, "on-right": 90 };

/** Rows of the shortest rotation that takes `up` to y. */
export function turnFor([x, y, z]) {
  if (y < -1 + 1e-9) return [1, 0, 0, 0, -1, 0, 0, 0, -1];
  const k = 1 / (1 + y);
  return [1 - k * x * x, -x, -k * x * z, x, y, z, -k * x * z, -z, 1 - k * z * z];
}

export class Settings {
  /** onChange(): a setting was changed. onTurn(axis): another axis of the file shall point upwards. */
  constructor(form, options, { onChange, onTurn }) {
    this.form = form;
    this.options = options;
    this.onChange = onChange;
    this.onTurn = onTurn;
    this.up = "auto";
    this.preset = options.preset;
    this.chosen = {};
    form.addEventListener("submit", (event) => event.preventDefault());
  }

  /** Everything that is shown, with the defaults of the preset. */
  get values() { return { ...this.options.presets[this.preset], ...this.chosen }; }

  /** The same for what a job was started with. */
  of(wanted) { return { ...this.options.presets[wanted.preset ?? this.options.preset], ...wanted }; }

  /** What the server is asked for: what differs from the preset. */
  wanted(up) {
    const preset = this.options.presets[this.preset];
    const changed = Object.entries(this.chosen).filter(([name, value]) => value !== preset[name]);
    return { preset: this.preset, ...Object.fromEntries(changed), ...(up && up !== "auto" ? { up } : {}) };
  }

  load({ preset, up, ...chosen }) {
    this.preset = preset ?? this.options.preset;
    this.chosen = chosen;
    this.up = up ?? "auto";
    this.draw();
  }

  #change(name, value) {
    this.chosen[name] = value;
    this.onChange();
  }

  draw() {
    const named = Object.fromEntries(this.options.settings.map((each) => [each.name, each]));
    const rest = this.options.settings.map((each) => each.name).filter((name) => !FIRST.includes(name));
    const focus = document.activeElement?.id;
    this.form.replaceChildren(
      el("h2", {}, t("settings.title")),
      ...FIRST.map((name) => this.#field(named[name])),
      this.#presets(),
      el("details", {}, el("summary", {}, t("settings.more")), ...rest.map((name) => this.#field(named[name])), this.#up()),
    );
    if (focus) document.getElementById(focus)?.focus();
  }

  /** A question mark that shows the help, and the help. */
  #help(name, text) {
    const key = `help.${name}`, help = el("p", { class: "help", id: `help-${name}`, hidden: true }, has(key) ? t(key) : language === "en" ? text : "");
    const mark = el("button", { type: "button", class: "mark", "aria-expanded": "false", "aria-controls": help.id, "aria-label": t("settings.help", { name: t(`setting.${name}`) }) }, "?");
    mark.addEventListener("click", () => { help.hidden = !help.hidden; mark.setAttribute("aria-expanded", String(!help.hidden)); });
    return [mark, help];
  }

  #up() {
    const select = el("select", { id: "set-up" }, ...this.options.up.map((axis) => el("option", { value: axis }, t(`up.${axis}`))));
    select.value = this.up;
    select.addEventListener("change", () => { this.up = select.value; this.onTurn(this.up); });
    return el("div", { class: "field" }, el("label", { for: "set-up" }, t("up.title")), select);
  }

  #field({ name, type, choices, help }) {
    if (name === "stand") return this.#stands(choices, help);
    const [mark, words] = this.#help(name, help);
    if (type === "choice") {
      const select = el("select", { id: `set-${name}`, "aria-describedby": `help-${name}` }, ...choices.map((choice) => el("option", { value: choice }, t(`${name}.${choice}`))));
      select.value = this.values[name];
      select.addEventListener("change", () => this.#change(name, select.value));
      return el("div", { class: "field" }, el("label", { for: `set-${name}` }, t(`setting.${name}`)), mark, select, words);
    }
    const [min, max, step] = RANGES[name], value = this.values[name];
    const exact = el("input", { type: "number", id: `set-${name}`, min: step, step: "any", value, inputmode: "decimal", "aria-describedby": `help-${name}` });
    const slide = el("input", { type: "range", min, max, step, value, "aria-label": t(`setting.${name}`), tabindex: -1 });
    slide.addEventListener("input", () => { exact.value = slide.value; this.#change(name, Number(slide.value)); });
    exact.addEventListener("input", () => { if (exact.value > 0) { slide.value = exact.value; this.#change(name, Number(exact.value)); } });
    return el("div", { class: "field" }, el("label", { for: `set-${name}` }, t(`setting.${name}`)), mark,
      el("div", { class: "pair" }, slide, exact, el("span", { class: "unit" }, "mm")), words);
  }

  #stands(choices, help) {
    const options = choices.map((choice) => {
      const radio = el("input", { type: "radio", name: "stand", value: choice, id: `set-stand-${choice}` });
      radio.checked = this.values.stand === choice;
      radio.addEventListener("change", () => this.#change("stand", choice));
      return el("label", {}, radio, figure(choice), el("span", {}, t(`stand.${choice}`)));
    });
    const [mark, words] = this.#help("stand", help);
    return el("fieldset", { class: "field" }, el("legend", {}, t("setting.stand")), mark, el("div", { class: "stands" }, ...options), words);
  }

  #presets() {
    const options = Object.keys(this.options.presets).map((name) => {
      const radio = el("input", { type: "radio", name: "preset", value: name, id: `set-preset-${name}` });
      radio.checked = this.preset === name;
      radio.addEventListener("change", () => { this.preset = name; this.onChange(); });
      return el("label", {}, radio, el("span", {}, t(`preset.${name}`)));
    });
    return el("fieldset", { class: "field" }, el("legend", {}, t("setting.preset")), el("div", { class: "choice" }, ...options), el("p", { class: "help" }, t("preset.help")));
  }
}

/** A head that stands, lies, or asks for the best way. */
function figure(stand) {
  const make = (name, attributes) => { const e = document.createElementNS("http://www.w3.org/2000/svg", name); for (const [k, v] of Object.entries(attributes)) e.setAttribute(k, v); return e; };
  const svg = make("svg", { viewBox: "0 0 32 32", "aria-hidden": "true" });
  if (stand === "auto") {
    svg.append(make("path", { d: "M6 22h20M10 22c0-8 3-12 6-12s6 4 6 12M13 27h6" }));
    return svg;
  }
  if (stand === "best") {
    svg.append(make("path", { d: "M16 4l3.4 7.6 8.1.9-6 5.6 1.7 8L16 22l-7.2 4.1 1.7-8-6-5.6 8.1-.9Z" }));
    return svg;
  }
  const front = ["upright", "upside-down", "on-left", "on-right"].includes(stand), turn = SIDES[stand];
  const body = make("g", { transform: `rotate(${turn} 16 16)` });
  body.append(make("path", { d: "M9 27c0-6 2-8 7-8s7 2 7 8Z" }), make("circle", { cx: 16, cy: 11, r: 7 }));
  if (front) body.append(make("circle", { class: "face", cx: 13.5, cy: 11, r: 1.5 }), make("circle", { class: "face", cx: 18.5, cy: 11, r: 1.5 }));
  else body.append(make("circle", { class: "face", cx: 21, cy: 11, r: 1.6 }));
  svg.append(body);
  return svg;
}

// All words of the page, from en.json and de.json.

const LANGUAGES = ["en", "de"];
let words = {}, english = {};
export let language = "en";

/** The text of a key, with {names} replaced. */
export function t(key, values = {}) {
  const text = words[key] ?? english[key] ?? key;
  return text.replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
}

/** Whether there are words for a key. */
export const has = (key) => key in words;

/** One key for one, another for many. */
export const plural = (key, count, values = {}) => t(count === 1 && has(`${key}.one`) ? `${key}.one` : key, { count, ...values });

export const number = (value, digits = 1) => new Intl.NumberFormat(language, { maximumFractionDigits: digits }).format(value);

/** An error in the language of the page, where there are words for its code. */
export function explain(error) {
  const key = `error.${error.code}`;
  return has(key) ? t(key) : sentence(error.message);
}

/** What a program says, as a sentence; names of files at its beginning stay as they are. */
export const sentence = (text) => (/^(the|there|this|an?) /.test(text ?? "") ? text[0].toUpperCase() + text.slice(1) : text ?? "");

export async function loadTexts(wanted) {
  const found = wanted ?? stored() ?? navigator.languages.map((l) => l.slice(0, 2)).find((l) => LANGUAGES.includes(l)) ?? "en";
  language = LANGUAGES.includes(found) ? found : "en";
  const load = async (name) => (await fetch(`/${name}.json`)).json();
  [words, english] = await Promise.all([load(language), load("en")]);
  document.documentElement.lang = language;
  if (wanted) try { localStorage.setItem("language", wanted); } catch { /* private window */ }
}

function stored() {
  try { return localStorage.getItem("language"); } catch { return null; }
}

/** Fill in all texts below an element: data-t for its content, data-t-LABEL for its attributes. */
export function translate(root = document) {
  for (const element of root.querySelectorAll("[data-t]")) element.textContent = t(element.dataset.t);
  for (const [data, attribute] of [["tLabel", "aria-label"], ["tTitle", "title"], ["tPlaceholder", "placeholder"]])
    for (const element of root.querySelectorAll(`[data-${data.replace(/[A-Z]/g, (c) => "-" + c.toLowerCase())}]`))
      element.setAttribute(attribute, t(element.dataset[data]));
}

/** An element: el("button", { class: "main", onclick: f }, "text", child). Text is never read as HTML. */
export function el(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

"use strict";
// Cards are made as the end of the page comes into view: the order of ten thousand costs milliseconds, their cards would cost seconds.
const AT_ONCE = 60;
const { parts, columns } = JSON.parse(document.getElementById("data").textContent);
const field = (id) => document.getElementById(id);
const grid = field("parts"), end = field("end");
let shown = [], made = 0;

function element(name, text, className) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  return made;
}

function card(part) {
  const article = element("article", undefined, part.state);
  const picture = element(part.report ? "a" : "div", undefined, "picture");
  if (part.report) picture.href = part.report;
  if (part.picture) {
    const image = element("img");
    image.loading = "lazy";
    image.decoding = "async";
    image.alt = `${part.name}: textured, as it is, refined`;
    image.addEventListener("error", () => image.replaceWith("no picture"));
    image.src = part.picture;
    picture.append(image);
  } else picture.append("no picture");
  const heading = element("h2", `${part.name} `);
  heading.append(element("small", part.state));
  article.append(picture, heading);
  if (part.text) article.append(element("p", part.text));
  const list = element("dl");
  for (const [key, label] of Object.entries(columns)) {
    const value = part.scores?.[key];
    if (value === undefined) continue;
    const row = element("div");
    row.append(element("dt", label), element("dd", Number(value.toPrecision(3)).toString()));
    list.append(row);
  }
  if (list.childElementCount) article.append(list);
  return article;
}

function more() {
  const next = shown.slice(made, made + AT_ONCE);
  grid.append(...next.map(card));
  made += next.length;
}

function fill() {
  // An observer reports changes only; where the end is still in view after a batch of cards, it would not report again
  while (made < shown.length && end.getBoundingClientRect().top < innerHeight + 800) more();
}

function update() {
  const key = field("sort").value, sign = field("descending").checked ? -1 : 1;
  const words = field("search").value.toLowerCase().split(/\s+/).filter(Boolean), state = field("state").value;
  shown = parts.filter((part) => {
    const text = `${part.name} ${part.text ?? ""}`.toLowerCase();
    return (!state || part.state === state) && words.every((word) => text.includes(word));
  });
  const names = (a, b) => a.name.localeCompare(b.name, undefined, { numeric: true });
  shown.sort((a, b) => {
    if (key === "name") return sign * names(a, b);
    const x = a.scores?.[key], y = b.scores?.[key];
    if (x === undefined || y === undefined) return (x === undefined) - (y === undefined) || names(a, b);  // last either way
    return sign * (x - y) || names(a, b);
  });
  grid.replaceChildren();
  made = 0;
  fill();
  field("count").textContent = `${shown.length.toLocaleString("en")} of ${parts.length.toLocaleString("en")}`;
}

new IntersectionObserver((entries) => entries.some((entry) => entry.isIntersecting) && fill(), { rootMargin: "800px" }).observe(end);
addEventListener("scroll", fill, { passive: true });
addEventListener("resize", fill, { passive: true });
for (const id of ["search", "sort", "descending", "state"]) field(id).addEventListener("input", update);
field("controls").addEventListener("submit", (event) => event.preventDefault());
update();

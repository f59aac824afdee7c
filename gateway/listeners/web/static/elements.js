// The elements of the page. Texts of others become text nodes, never markup.
import { sentence, word } from "./words.js";

export const $ = (id) => document.getElementById(id);
export const make = (tag, text, kind) => {
  const found = document.createElement(tag);
  if (text !== undefined) found.textContent = text;
  if (kind) found.className = kind;
  return found;
};
export const put = (place, text) => { if (place.textContent !== text) place.textContent = text; };
// A part is drawn again only when it has changed, so that nothing jumps and what is selected stays selected.
const known = new Map();
export const changed = (id, data) => {
  const text = JSON.stringify(data);
  if (known.get(id) === text) return false;
  known.set(id, text);
  return true;
};
export const draw = (id, data, nodes) => { if (changed(id, data)) $(id).replaceChildren(...nodes()); };
export const marked = (mark) => mark ? make("span", word("mark." + mark), "mark m-" + mark) : "";

export const afterPaint = (draw) => requestAnimationFrame(() => setTimeout(draw));

// A thermal error by its name, and what that means.
export const named = (error, tag) => {
  const cell = make(tag, error, "when");
  cell.append(" ", make("small", word("error." + error)));
  return cell;
};

const colours = ["away", "red", "grey", "amber", "green"];
export const paint = (place, colour) => {
  if (place.classList.contains(colour)) return;
  place.classList.remove(...colours);
  place.classList.add(colour);
};
export const say = (list, kind) => list.map((each) => make("p", sentence(each), kind));
export const rows = (list) => list.map((row) => {
  const each = make("div"), value = make("dd", sentence(row.said));
  value.prepend(marked(row.mark), row.mark ? " " : "");
  each.append(make("dt", word(row.label)), value);
  return each;
});

const SVG = "http://www.w3.org/2000/svg";
// inside: other elements, or a text
export const drawn = (tag, attributes, ...inside) => {
  const found = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) found.setAttribute(name, value);
  found.append(...inside);
  return found;
};
// A piece of a bar: from and to in percent of its length.
export const piece = (kind, from, to = from) => {
  const found = make("i", undefined, kind);
  found.style.left = `${from}%`;
  found.style.width = `${Math.max(to - from, 0)}%`;
  return found;
};

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
const drawn = new Map();
export const changed = (id, data) => {
  const text = JSON.stringify(data);
  if (drawn.get(id) === text) return false;
  drawn.set(id, text);
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

const colours = ["red", "grey", "amber", "green"];
export const paint = (place, colour) => {
  if (place.classList.contains(colour)) return;
  place.classList.remove(...colours);
  place.classList.add(colour);
};
export const say = (list, kind) => list.map((each) => make("p", sentence(each), kind));
// room: by label, the longest text that may stand there
export const rows = (list, room = {}) => list.map((row) => {
  const each = make("div"), value = make("dd"), said = make("div", sentence(row.said));
  said.prepend(marked(row.mark), row.mark ? " " : "");
  value.append(said);
  if (row.label in room) {
    value.className = "room";
    value.append(make("div", room[row.label], "spare"));
  }
  each.append(make("dt", word(row.label)), value);
  return each;
});

// A part that has grown keeps its height: what comes and goes with each measurement would push the parts below about.
export const keepHeights = (parts) => {
  const kept = new ResizeObserver((all) => all.forEach(({ target }) => { target.style.minHeight = `${target.getBoundingClientRect().height}px`; }));
  let width = innerWidth;
  addEventListener("resize", () => {
    if (innerWidth === width) return;
    width = innerWidth;
    parts.forEach((part) => { part.style.minHeight = ""; });
  });
  parts.forEach((part) => kept.observe(part));
};

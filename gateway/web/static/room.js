// Room for the verdict: what may be said in each place is laid out there, unseen, with long numbers, times and names.
import { $, changed } from "./elements.js";
import { longest, sentence, time } from "./words.js";

const days = Array.from({ length: 366 }, (_, day) => new Date(2024, 0, 1 + day, 23, 58).toISOString());
const at = { t: days.reduce((a, b) => (time(b).length > time(a).length ? b : a)) };
const um = { n: 188.8, u: "µm", d: 1 };
const LONG = {
  at, left: um, half: um, far: um, off: um, gain: { ...um, sign: true }, tolerance: um, low: um, high: um, axis: { s: "X" }, axes: { s: "X, Y, Z" },
  why: { s: longest("why") }, source: { s: longest("source") },
};

// load: of the planned loads
export const reserve = (part, load = "") => part.querySelectorAll("[data-room]").forEach((place) => {
  const values = { ...LONG, what: { w: place.dataset.what }, load: { s: load } };
  place.textContent = sentence({ say: place.dataset.room, values });
});

// loads: their names, as far as the page has heard of them
export const reservePlanned = (loads) => {
  if (!changed("planned-room", loads)) return;
  $("planned-room").replaceChildren(...loads.map((load) => {
    const line = $("planned-line").content.cloneNode(true);
    reserve(line, load);
    return line;
  }));
};

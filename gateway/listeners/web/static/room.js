// Room for what comes and goes: what may be said in each place is laid out there, unseen, with long numbers, times and names.
import { $, changed } from "./elements.js";
import { longest, longestKey, sentence, time } from "./words.js";

// Each weekday of each month, with two digits.
const days = Array.from({ length: 12 * 7 }, (_, i) => new Date(2024, Math.floor(i / 7), 22 + i % 7, 23, 58).toISOString());
const at = { t: days.map((day) => [time(day).length, day]).reduce((a, b) => (b[0] > a[0] ? b : a))[1] };
const um = { n: 188.8, u: "µm", d: 1 };
export const LONG = {
  at, left: um, half: um, far: um, off: um, gain: { ...um, sign: true }, low: um, high: um, axis: { s: "X" }, axes: { s: "X, Y, Z" },
  by: { s: "maintenance team" }, why: { s: longest("why") }, source: { s: longest("source") }, mode: { s: longest("mode") },
  now: um, then: um, measured: um, hours: { n: 8, u: "h", d: 1 }, reason: { s: "a touch is missing" }, text: { s: "channel spindle_growth: comm_fault: no answer within 0.5 s" },
};
const mark = longestKey("mark").slice("mark.".length);
const row = (label, say, mark) => ({ label: "label." + label, mark, said: { say, values: LONG } });
const wordRow = (label, group, mark) => ({ label: "label." + label, mark, said: { say: longestKey(group), values: {} } });
// The rows of what the machine waits for, with two things that have to come first.
export const WAITS = [
  wordRow("phase", "phase"), row("first", "sentence.text", mark), row("first", "sentence.text", mark), wordRow("probing", "standing", mark),
  wordRow("why", "why"), row("waits_for", "sentence.text", mark), row("operator", "sentence.text", mark), row("next", "next.expected"),
  row("last", "last.failed", mark), row("waiting", "waiting.cost"),
];

// The longest texts of the rows about health.
export const HEALTH = {
  "label.control": `${longest("mark")} ${sentence({ say: "control.step", values: LONG })}`,
  "label.nc": `${longest("mark")} ${longest("nc")}`,
  "label.spool": sentence({ say: "spool.oldest", values: { n: { n: 1888, d: 0 }, oldest: { n: 88, u: "s", d: 0 } } }),
};
export const QUALITY = longestKey("quality");

// load: of the planned loads
export const reserve = (part, load = "") => part.querySelectorAll("[data-room]").forEach((place) => {
  const values = { ...LONG, what: { w: place.dataset.what }, load: { s: load } };
  place.textContent = sentence({ say: place.dataset.room, values });
});

// loads: their names, as far as the page has heard of them
export const reservePlanned = (loads) => {
  if (!changed("planned-room", loads)) return;
  for (const room of document.querySelectorAll(".planned-room")) room.replaceChildren(...loads.map((load) => {
    const line = $("planned-line").content.cloneNode(true);
    reserve(line, load);
    return line;
  }));
};

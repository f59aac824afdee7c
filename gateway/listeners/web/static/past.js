// What the gateway has stored, and what this page has heard of each channel since it was opened.
import { machine, query } from "./choice.js";
import { answerTo, atom } from "./words.js";

// from, to: UTC seconds; also: "temperatures" or "errors" are asked for, too. Returns columns, or why there are none.
export const fetchPast = async (from, to, also = "") => {
  const { ok, told } = await answerTo(`/past/${encodeURIComponent(machine)}?from=${from}&to=${to}&${query()}${also && `&${also}=1`}`);
  return ok ? { found: told, why: "" } : { found: null, why: atom(told) };
};

const EVERY_S = 10, MOST = 2880;
const heard = new Map();
// t: the gateway's time, UTC seconds
export const hear = (channels, t) => {
  for (const c of channels) {
    if (!heard.has(c.channel)) heard.set(c.channel, { t: [], v: [], u: "" });
    const own = heard.get(c.channel);
    if (c.value) own.u = c.value.u;
    if (own.t.length && t - own.t.at(-1) < EVERY_S) continue;
    own.t.push(t);
    own.v.push(c.good && c.value ? c.value.n : null);
    if (own.t.length > MOST) { own.t.shift(); own.v.shift(); }
  }
};
// A speed has the same unit from every control; of another machine state none is told.
export const stateUnit = (state) => state === "spindle_speed" || /^speed_[ABC]$/.test(state) ? "1/min" : /^speed_[XYZ]$/.test(state) ? "mm/min" : "";
export const unit = (channel) => heard.get(channel)?.u ?? "";
// Stored temperatures, and then what was heard. stored: with temperatures; null: nothing is
export const trend = (channel, stored) => {
  const own = heard.get(channel) ?? { t: [], v: [] }, column = stored?.temperatures[channel], from = own.t[0] ?? Infinity;
  const before = column ? stored.t.flatMap((t, i) => t < from ? [i] : []) : [];
  return [[...before.map((i) => stored.t[i]), ...own.t], [...before.map((i) => column[i]), ...own.v]];
};

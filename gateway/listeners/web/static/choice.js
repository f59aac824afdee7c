// The machine that the page shows, and what this browser asks to see of it, and of the others.
import { $, put } from "./elements.js";
import { amount, plain, word } from "./words.js";

export const machine = document.body.dataset.machine;

const FARTHEST = [-1e4, 1e4];
const LIMITS = { tolerance: [0.1, 1e4], x: FARTHEST, y: FARTHEST, z: FARTHEST, a: FARTHEST, c: FARTHEST };
const within = (name, value) => Object.hasOwn(LIMITS, name) && value >= LIMITS[name][0] && value <= LIMITS[name][1];
// As people write them: with a comma or a point, and perhaps with the sign or the unit that stands beside the field.
export const number = (text) => {
  const bare = text.trim().replace(/^±\s*/, "").replace(/\s*(µm|μm|um|mm|°)$/, "").replace("\u2212", "-");
  return /^[+-]?(\d+([.,]\d*)?|[.,]\d+)$/.test(bare) ? Number(bare.replace(",", ".")) : NaN;
};

// The choice of this browser, kept by machine; whatever else stands there counts for nothing.
const KEY = "asked ";
const kept = (name) => {
  try {
    const found = JSON.parse(localStorage.getItem(KEY + name)) || {};
    return Object.fromEntries(Object.entries(found).filter(([what, value]) => value !== "" && within(what, Number(value))).map(([what, value]) => [what, String(value)]));
  } catch { return {}; }
};
export const query = () => new URLSearchParams(kept(machine)).toString();
// What this browser asks of each machine, for the list of them.
export const queryOfAll = () => {
  let names = [];
  try { names = Object.keys(localStorage).filter((key) => key.startsWith(KEY)).map((key) => key.slice(KEY.length)); } catch { /* not allowed */ }
  const all = Object.fromEntries(names.map((name) => [name, kept(name)]).filter(([, own]) => Object.keys(own).length));
  return Object.keys(all).length ? new URLSearchParams({ asked: JSON.stringify(all) }).toString() : "";
};

// X, Y, Z, mm, and A, C, degrees, of the point that is shown.
export const point = () => {
  const own = kept(machine);
  return ["x", "y", "z", "a", "c"].map((name) => Number(own[name] ?? document.querySelector(`#asked [name=${name}]`).dataset.declared));
};
let fill = () => {};
const ofSphere = () => ["x", "z"].map((name) => document.querySelector(`#asked [name=${name}]`));
// told: radius and height of the probing sphere, mm; null: the gateway does not tell
export const keepSphere = (told) => {
  if (!told) return;
  $("sphere-unknown").hidden = true;
  if (ofSphere().every((input, i) => input.dataset.declared === String(told[i]))) return;
  ofSphere().forEach((input, i) => { input.dataset.declared = String(told[i]); });
  fill();
};
// The same as told or declared; null: neither.
export const sphere = () => $("sphere-unknown").hidden ? ofSphere().map((input) => Number(input.dataset.declared)) : null;
// changed: called after each new choice
export const readyChoice = (changed) => {
  const form = $("asked"), inputs = [...form.elements].filter((each) => each.name in LIMITS);
  const declared = (input) => input.dataset.declared === "" ? null : Number(input.dataset.declared);
  fill = () => {
    const own = kept(machine);
    for (const input of inputs) {
      const value = own[input.name] ?? declared(input);
      input.value = value === null ? "" : plain(Number(value));
    }
    put($("place"), ["X", "Y", "Z", "A", "C"].map((name, i) => `${name}\u202f${amount({ n: point()[i], d: point()[i] % 1 ? 1 : 0 })}`).join("  "));
    put($("tolerance-from"), word("tolerance" in own ? "tool.typed" : inputs[0].dataset.declared === "" ? "tool.none" : "tool.declared"));
  };
  const keep = (own) => {
    const before = query();
    localStorage.setItem(KEY + machine, JSON.stringify(own));
    fill();
    if (query() !== before) changed();
  };
  const check = (input) => {
    const [least, most] = LIMITS[input.name], right = input.value.trim() === "" || within(input.name, number(input.value));
    const values = { least: { n: least, d: least % 1 ? 1 : 0 }, most: { n: most, d: 0 }, such: { n: 5.5, d: 1 } };
    input.setCustomValidity(right ? "" : word("tool.number").replace(/\{(\w+)\}/g, (_, name) => amount(values[name])));
    return right;
  };
  const take = () => {
    if (!inputs.map(check).every((right) => right)) { form.reportValidity(); return; }
    const typed = inputs.filter((input) => input.value.trim() !== "").map((input) => [input, number(input.value)]);
    keep(Object.fromEntries(typed.filter(([input, value]) => value !== declared(input)).map(([input, value]) => [input.name, String(value)])));
  };
  form.noValidate = true;
  form.addEventListener("submit", (event) => { event.preventDefault(); take(); });
  form.addEventListener("reset", (event) => { event.preventDefault(); keep({}); });
  for (const input of inputs) input.addEventListener("input", () => input.setCustomValidity(""));
  $("tolerance").addEventListener("change", take);
  // By a tenth below 1 µm, by a half below 10, else by a whole one.
  const step = (by) => {
    const value = number($("tolerance").value), size = value < 1 || (by < 0 && value === 1) ? 0.1 : value < 10 || (by < 0 && value === 10) ? 0.5 : 1;
    if (Number.isNaN(value)) return;
    $("tolerance").value = plain(Math.max(Math.round((value + by * size) * 10) / 10, LIMITS.tolerance[0]));
    take();
  };
  $("tighter").addEventListener("click", () => step(-1));
  $("wider").addEventListener("click", () => step(1));
  fill();
};

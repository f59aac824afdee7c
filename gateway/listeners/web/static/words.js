// Says what the server sends: sentences of the catalogue, numbers and times as the browser's locale writes them.
// No line ends between a number and what belongs to it.
const texts = JSON.parse(document.getElementById("texts").textContent, (_, text) => typeof text === "string" ? text.replace(/± /g, "±\u00a0").replace(/ %/g, "\u00a0%") : text);

const has = (key) => Object.hasOwn(texts, key);
export const word = (key) => has(key) ? texts[key] : key.replace(/^[a-z]+\./, "").replaceAll("_", " ");
export const clock = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit" });
export const day = new Intl.DateTimeFormat(undefined, { weekday: "short", day: "numeric", month: "short", hour: "2-digit", minute: "2-digit" });
// For the hour that occurs twice when clocks are put back.
const named = new Intl.DateTimeFormat(undefined, { weekday: "short", day: "numeric", month: "short", hour: "2-digit", minute: "2-digit", timeZoneName: "short" });
const HOUR_MS = 3600e3;
const twice = (at) => [-HOUR_MS, HOUR_MS].some((by) => new Date(at.getTime() + by).getHours() === at.getHours());
export const date = new Intl.DateTimeFormat(undefined, { day: "numeric", month: "short" });
export const whole = new Intl.DateTimeFormat(undefined, { dateStyle: "full", timeStyle: "short" });
export const exact = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit" });
// The present by the server's clock; this browser's may be wrong.
let ahead = 0;
export const present = () => new Date(Date.now() + ahead);
// The day of a simulated machine, whose clock is not this one; null: of any other.
let simulated = null;
export const setToday = (at) => { simulated = at; };
export const today = () => simulated ?? present();
// Returns by how many milliseconds the server is ahead.
export const setPresent = (ms) => (ahead = ms - Date.now());
export const time = (iso) => {
  const at = new Date(iso);
  if (Number.isNaN(at.getTime())) return "–";
  return (twice(at) ? named : at.toDateString() === today().toDateString() ? clock : day).format(at);
};
// The same, with the weekday alone of the last days.
export const weekday = new Intl.DateTimeFormat(undefined, { weekday: "short", hour: "2-digit", minute: "2-digit" });
export const recent = (iso) => time(iso) === clock.format(new Date(iso)) || today() - new Date(iso) > 6 * 24 * HOUR_MS ? time(iso) : weekday.format(new Date(iso));
// How long ago, by the clock of what is shown.
export const lasted = (iso) => {
  const hours = (today() - new Date(iso)) / HOUR_MS;
  return hours < 1 ? amount({ n: Math.floor(hours * 60), u: "min", d: 0 }) : amount({ n: Math.floor(hours), u: "h", d: 0 });
};
// As it is typed in: without separated thousands.
export const plain = (n) => new Intl.NumberFormat(undefined, { useGrouping: false, maximumFractionDigits: 3 }).format(n);
const numbers = new Map();
export const amount = ({ n, u, d, sign }) => {
  if (n === null || n === undefined) return "–";
  const key = d + (sign ? "+" : "");
  if (!numbers.has(key)) numbers.set(key, new Intl.NumberFormat(undefined, {
    minimumFractionDigits: d, maximumFractionDigits: d, signDisplay: sign ? "exceptZero" : "auto" }));
  return numbers.get(key).format(n).replace("-", "\u2212") + (u ? "\u202f" + u : "");
};
export const atom = (a) => {
  if (a === undefined) return "–";
  if ("say" in a) return sentence(a);
  if ("w" in a) return word(a.w);
  if ("s" in a) return a.s;
  if ("x" in a) return a.x[document.documentElement.lang];
  if ("t" in a) return time(a.t);
  return amount(a);
};
// What the server answers: whether it is what was asked for, and what it tells. It may be cut off within it.
export const answerTo = async (address) => {
  try {
    const answer = await fetch(address);
    return { ok: answer.ok, told: answer.ok || answer.status === 503 ? await answer.json() : { s: await answer.text() } };
  } catch { return { ok: false, told: { w: "word.lost" } }; }
};
export const sentence = ({ say, values }) => word(say).replace(/\{(\w+)\}/g, (_, name) => atom(values[name]));

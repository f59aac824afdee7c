// Every channel with its last hours: those without a good value first. A click shows it on the screen of time.
import { $, afterPaint, changed, draw, make, marked, drawn, put, say } from "./elements.js";
import { showChannel } from "./chart.js";
import { heat } from "./model.js";
import { fetchPast, trend } from "./past.js";
import { amount, sentence, word } from "./words.js";

const HOURS = 8, AGAIN_MS = 600e3, WIDE = 110, HIGH = 26, LEAST = 2;
let latest = null, body = "", stored = null, askedMs = -Infinity;
const doubt = (said) => { const p = make("p", sentence(said), "doubt"); p.prepend(marked("bad"), " "); return p; };
const line = (channel, value) => {
  const [t, v] = trend(channel, stored), found = t.flatMap((each, i) => v[i] !== null && each > t.at(-1) - HOURS * 3600 ? [[each, v[i]]] : []);
  const picture = drawn("svg", { viewBox: `0 0 ${WIDE} ${HIGH}`, "aria-hidden": "true", class: "spark" });
  if (found.length < 2) return { picture, rate: null };
  const [from, to] = [t.at(-1) - HOURS * 3600, t.at(-1)], values = found.map((p) => p[1]);
  // Its own scale, of at least two kelvins, so that noise stays flat.
  const middle = (Math.max(...values) + Math.min(...values)) / 2, wide = Math.max(Math.max(...values) - Math.min(...values), LEAST);
  const path = drawn("path", { d: "M" + found.map(([at, n]) => `${((at - from) / (to - from) * WIDE).toFixed(1)} ${(HIGH / 2 - (n - middle) / wide * (HIGH - 4)).toFixed(1)}`).join("L") });
  if (value && value.u === "°C") path.style.setProperty("--heat", heat(value.n)); else path.setAttribute("class", "plain");
  picture.append(path);
  const hour = found.find(([at]) => at >= to - 3600);
  return { picture, rate: hour && to - hour[0] > 1800 ? (found.at(-1)[1] - hour[1]) / (to - hour[0]) * 3600 : null };
};
// What it is compared with by eye: those with which it may be exchanged, else some of the same part that measure the same.
const NEIGHBOURS = 3, DOUBTS = { offset: "doubt.offset", swap: "doubt.swap" };
const beside = (c) => c.beside.length ? c.beside : latest.channels
  .filter((each) => c.body && each.body === c.body && each.channel !== c.channel && each.value?.u === (c.value?.u ?? "°C")).slice(0, NEIGHBOURS).map((each) => each.channel);
const item = (c) => {
  const found = make("li", undefined, c.good ? c.doubt && "doubted" : "not-good"), link = make("a", undefined, "channel"), { picture, rate } = line(c.channel, c.value);
  link.href = "#time";
  link.addEventListener("click", () => showChannel(c.channel, beside(c)));
  link.append(make("span", c.channel, "name"), " ", picture, " ");
  if (c.good || c.value) link.append(make("span", c.value ? amount(c.value) : "–", "number"));
  if (c.good && c.doubt) link.append(" ", make("span", word(DOUBTS[c.doubt] ?? c.doubt), "mark m-notice"));
  else if (c.good) link.append(" ", make("span", rate === null ? "" : amount({ n: rate, u: (c.value.u === "°C" ? "K" : c.value.u) + "/h", d: 1, sign: true }), "rate"));
  else link.append(" ", make("span", word(c.quality), "mark m-bad"));
  if (c.detail || c.beside.length) link.title = [c.detail ? sentence(c.detail) : "", c.beside.join(", ")].filter(Boolean).join("; ");
  found.append(link);
  return found;
};
const choices = (channels) => {
  const there = [...new Set(channels.map((c) => c.body))].filter(Boolean).sort();
  if (!changed("bodies", [there, body])) return;
  document.querySelector('[data-choice="body"]').replaceChildren(...["", ...there].map((each) => {
    const link = make("a", each ? word("body." + each) : word("events.all"));
    link.href = each ? `#sensors/${each}` : "#sensors";
    if (each === body) link.setAttribute("aria-current", "true");
    return link;
  }));
};
const list = () => {
  const shown = latest.channels.filter((c) => !body || c.body === body);
  draw("channels", [shown, body, stored && stored.t.at(-1)], () => shown.map(item));
};
const load = async () => {
  if (!latest.gateway_time || performance.now() - askedMs < AGAIN_MS) return;
  askedMs = performance.now();
  const now = Date.parse(latest.gateway_time) / 1e3;
  stored = (await fetchPast(now - HOURS * 3600, now, "temperatures")).found;
  list();
};
export const showSensors = (v) => {
  latest = v;
  const bad = v.channels.filter((c) => !c.good).length;
  $("failed-count").hidden = !bad;
  put($("failed-count"), amount({ n: bad, d: 0 }));
  const doubts = v.doubts.filter((each) => each.say !== "doubt.alike"), alike = v.doubts.filter((each) => each.say === "doubt.alike");
  draw("doubts", v.doubts, () => [...(doubts.length ? doubts.map(doubt) : v.channels.length ? [make("p", word("doubt.none"), "note")] : []), ...say(alike, "note")]);
  put($("watched"), v.watched ? sentence(v.watched) : "");
  $("heat-empty").hidden = v.channels.length > 0;
  choices(v.channels);
  list();
  afterPaint(load);  // also for paper, of which nobody says beforehand that it will be wanted
};
// shown: what the screens show
export const showBody = (shown) => {
  body = shown.body;
  if (latest) showSensors(latest);
};

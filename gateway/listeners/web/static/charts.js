// The charts: one time axis, one cursor; drag to zoom, scroll sideways (or with Shift) to go back, double click to see all.
import { machine, query } from "./choice.js";
import { $, afterPaint, make, put } from "./elements.js";
import { amount, clock, date, sentence, time, word } from "./words.js";

let charts = [], course = null, zoomed = false, following = false, forecast = true;
// What the gateway has stored of before: thinned over the chosen span, and finer where somebody has zoomed in.
let past = null, fine = null, asking = 0, pastTo = null, askedMs = -Infinity;
const AGAIN_S = 1800, PATIENCE_MS = 60000;
const NO_PAST = { t: [], without: [[], [], []], half: [[], [], []], measured_t: [], measured: [[], [], []] };
const span = () => Number($("span").value) * 3600;
const fetchPast = async (from, to) => {
  const own = ++asking;
  const answer = await fetch(`/past/${encodeURIComponent(machine)}?from=${from}&to=${to}&${query()}`).catch(() => null);
  if (own !== asking) return null;
  const found = answer && answer.ok ? await answer.json() : null;
  const why = answer ? answer.ok ? "" : await answer.text() : word("word.lost");
  put($("past-problem"), why ? word("chart.no_past").replace("{at}", time(to * 1e3)).replace("{why}", why) : "");
  return found;
};
const began = () => course && course.t.length ? course.t[0] : Date.now() / 1e3;
const loadPast = async () => {
  const to = began(), from = (course && course.t.length ? course.t.at(-1) : to) - span();
  fine = null;
  pastTo = to;
  askedMs = performance.now();
  const wanted = to - from > 300, found = wanted ? await fetchPast(from, to) : null;
  if (found || !wanted) past = found; else if (pastTo === to) pastTo = null;
  redraw();
};
const refine = async (min, max) => {
  const to = Math.min(max, began());
  if (!past || to - min < 300) return;
  const found = await fetchPast(min, to);
  if (found) { fine = { ...found, min, to }; redraw(); }
};
const pick = (p, keep, keepDots) => {
  const at = p.t.flatMap((t, j) => keep(t) ? [j] : []), dots = p.measured_t.flatMap((t, j) => keepDots(t) ? [j] : []);
  return { t: at.map((j) => p.t[j]), without: p.without.map((c) => at.map((j) => c[j])), half: p.half.map((c) => at.map((j) => c[j])),
    measured_t: dots.map((j) => p.measured_t[j]), measured: p.measured.map((c) => dots.map((j) => c[j])) };
};
// What the page has heard itself stands in front of what is stored.
const before = () => {
  if (!past) return NO_PAST;
  const oldest = began() - 1, dot = course.measured_t.length ? course.measured_t[0] - 1 : Infinity;
  const within = (t) => fine !== null && t >= fine.min && t < fine.to;
  const coarse = pick(past, (t) => t < oldest && !within(t), (t) => t < dot && !within(t));
  if (!fine) return coarse;
  const more = pick(fine, (t) => t < oldest && within(t), (t) => t < dot && within(t)), both = { ...NO_PAST };
  const order = [...coarse.t, ...more.t].map((t, j) => [t, j]).sort((a, b) => a[0] - b[0]).map((e) => e[1]);
  const dots = [...coarse.measured_t, ...more.measured_t].map((t, j) => [t, j]).sort((a, b) => a[0] - b[0]).map((e) => e[1]);
  const merge = (a, b, by) => { const all = [...a, ...b]; return by.map((j) => all[j]); };
  both.t = merge(coarse.t, more.t, order);
  both.without = [0, 1, 2].map((i) => merge(coarse.without[i], more.without[i], order));
  both.half = [0, 1, 2].map((i) => merge(coarse.half[i], more.half[i], order));
  both.measured_t = merge(coarse.measured_t, more.measured_t, dots);
  both.measured = [0, 1, 2].map((i) => merge(coarse.measured[i], more.measured[i], dots));
  return both;
};
let refining = 0;
const follow = (u, key) => {
  if (key !== "x" || following) return;
  const { min, max } = u.scales.x;
  following = true;
  const all = u.data[0];
  zoomed = all.length > 1 && (min > all[0] || max < all.at(-1));
  clearTimeout(refining);
  if (zoomed) refining = setTimeout(refine, 300, min, max);
  charts.forEach((other) => { if (other !== u) other.setScale("x", { min, max }); });
  following = false;
};
// Sideways, or with Shift: the page itself scrolls up and down. What is not loaded yet follows as for a zoom.
const HALF_YEAR_S = 183 * 86400;
const scroll = (u, event) => {
  const by = event.deltaX || (event.shiftKey ? event.deltaY : 0);
  if (!by || u.data[0].length < 2) return;
  event.preventDefault();
  goBy(u, by / u.over.clientWidth);
};
// widths: how far, of what is seen
const goBy = (u, widths) => {
  const { min, max } = u.scales.x, last = u.data[0].at(-1);
  const wanted = (max - min) * widths;
  const shift = Math.min(Math.max(wanted, last - HALF_YEAR_S - min), last - max);
  if (shift) u.setScale("x", { min: min + shift, max: max + shift });
};
const pointAt = (u, j) => charts.forEach((each) => each.setCursor({ left: each.valToPos(u.data[0][j], "x"), top: each.over.clientHeight / 2 }));
const ZOOM = 2;
const zoomAt = (u, j, by) => {
  const { min, max } = u.scales.x, all = u.data[0], at = all[j];
  u.setScale("x", { min: Math.max(at - (at - min) * by, all[0]), max: Math.min(at + (max - at) * by, all.at(-1)) });
  pointAt(u, j);
};
// By keyboard: arrows move the cursor, + and - zoom at it, PageUp and PageDown go back and forth, Home shows everything.
const KEYS = {
  ArrowLeft: (u, j, seen) => pointAt(u, Math.max(j - 1, seen[0])), ArrowRight: (u, j, seen) => pointAt(u, Math.min(j + 1, seen[1])),
  "+": (u, j) => zoomAt(u, j, 1 / ZOOM), "-": (u, j) => zoomAt(u, j, ZOOM),
  PageUp: (u) => goBy(u, -1 / ZOOM), PageDown: (u) => goBy(u, 1 / ZOOM),
  Home: (u) => u.setScale("x", { min: u.data[0][0], max: u.data[0].at(-1) }),
};
const press = (i, event) => {
  const u = charts[i], key = event.key, seen = u && u.series[0].idxs;
  if (!seen || !Object.hasOwn(KEYS, key) || event.ctrlKey || event.altKey || event.metaKey || u.data[0].length < 2) return;
  event.preventDefault();
  // A screen reader says what this chart shows, and not what the others show at the same time.
  document.querySelectorAll("#axes .reading").forEach((note, k) => note.setAttribute("aria-live", k === i ? "polite" : "off"));
  const j = u.cursor.idx;
  KEYS[key](u, j === null || j === undefined ? seen[1] : j, seen);
};
const columns = (i) => {
  const { t, without, left, half, measured_t, measured, ahead, ahead_half } = course, old = before();
  const ahead_t = forecast ? course.ahead_t : [];
  const edge = (values, halves, sign) => values.map((v, j) => v === null || halves[j] === null ? null : v + sign * halves[j]);
  const line = [...old.without[i], ...without[i]], wide = [...old.half[i], ...half[i]];
  return uPlot.join([[[...old.t, ...t], line, edge(line, wide, -1), edge(line, wide, 1), [...old.t.map(() => null), ...left[i]]],
    [[...old.measured_t, ...measured_t], [...old.measured[i], ...measured[i]]],
    [ahead_t, ...[ahead[i], edge(ahead[i], ahead_half[i], -1), edge(ahead[i], ahead_half[i], 1)].map((c) => (forecast ? c : []))]]);
};
// place: of one chart; width: in pixels, measured before anything is drawn; ink: a colour of the page by its name
const chart = (place, i, width, ink) => {
  const value = (_, v) => amount({ n: v, u: "µm", d: 1, sign: true });
  const axis = { stroke: ink("soft"), grid: { stroke: ink("line"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
  const line = (label, colour, more) => ({ label: word("chart." + label), stroke: ink(colour), width: 1.5, points: { show: false }, value, spanGaps: true, ...more });
  return new uPlot({
    width, height: 150,
    axes: [{ ...axis, size: 26, space: 70, values: (_, all, __, ___, step) => all.map((v) => (step < 86400 ? clock : date).format(new Date(v * 1e3))) },
      { ...axis, size: 40, space: 30, values: (_, all) => all.map((v) => amount({ n: v, d: 0 })) }],
    scales: { y: { range: (_, min, max) => { const pad = Math.max((max - min) * 0.1, 1); return [min - pad, max + pad]; } } },
    series: [{ label: word("chart.time"), value: (_, v) => v === null ? "–" : time(v * 1e3) },
      line("without", "before"), line("low", "band", { width: 0 }), line("high", "band", { width: 0 }),
      line("left", "after", { dash: [6, 3], width: 2 }),
      line("measured", "measured", { paths: () => null, points: { show: true, size: 6, fill: ink("measured") } }),
      line("ahead", "before", { dash: [2, 4], width: 2 }), line("low", "band", { width: 0 }), line("high", "band", { width: 0 })],
    bands: [{ series: [3, 2], fill: ink("band") }, { series: [8, 7], fill: ink("band") }],
    legend: { show: false },
    cursor: { sync: { key: "tool" }, drag: { x: true, y: false } },
    hooks: { setScale: [follow], setCursor: [(u) => tell(u, i)],
      ready: [(u) => u.over.addEventListener("wheel", (event) => scroll(u, event), { passive: false })] },
  }, columns(i), place);
};
const tell = (u, i) => {
  const at = u.cursor.idx, place = u.root.parentNode;
  let note = place.querySelector(".reading");
  if (!note) { note = make("p", undefined, "reading"); place.append(note); }
  if (at === null || at === undefined) { put(note, "\u00a0"); return; }
  const value = (s) => amount({ n: u.data[s][at], u: "µm", d: 1, sign: true });
  const later = u.data[1][at] == null && u.data[6][at] != null;
  put(note, `${time(u.data[0][at] * 1e3)}: ` + (later ? `${word("chart.ahead")} ${value(6)}`
    : `${word("chart.without")} ${value(1)}, ${word("chart.left")} ${value(4)}`));
};
const drawCharts = () => {
  charts.forEach((u) => u.destroy());
  charts = [];
  if (!course || !(course.t.length || past)) return;
  const places = [...document.querySelectorAll("#axes .chart")], style = getComputedStyle(document.documentElement);
  places.forEach((place) => place.replaceChildren());
  const widths = places.map((place) => place.clientWidth), ink = (name) => style.getPropertyValue("--" + name).trim();
  charts = places.map((place, i) => chart(place, i, widths[i], ink));
  charts.forEach(tell);
};
const redraw = () => {
  if (!course) return;
  if (charts.length) charts.forEach((u, i) => u.setData(columns(i), !zoomed));
  else afterPaint(() => { if (!charts.length) drawCharts(); });  // they have their place, and the words come first
};
// What was foreseen does not hold while nobody knows what has come.
export const keepForecast = (kept) => {
  if (forecast === kept) return;
  forecast = kept;
  redraw();
};
export const showCourse = (c) => {
  course = c;
  put($("chart-note"), c.said ? sentence(c.said) : "");
  redraw();
  // What it has heard itself moves on after eight hours; a gateway that did not answer may have come back.
  if (pastTo === null ? performance.now() - askedMs > PATIENCE_MS : Math.abs(began() - pastTo) > AGAIN_S) loadPast();
};

// Whatever is known was said of another point of the tool.
export const forgetCourse = () => { zoomed = false; course = null; past = null; pastTo = null; askedMs = -Infinity; };
export const readyCharts = () => {
  document.querySelectorAll("#axes .chart").forEach((place, i) => place.addEventListener("keydown", (event) => press(i, event)));
  $("span").addEventListener("change", () => { zoomed = false; loadPast(); });
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; drawCharts(); } });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawCharts);
};

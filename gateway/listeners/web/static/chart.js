// The course of everything on one axis of time: drag, wheel or pinch to zoom, sideways to go back, click for a moment.
import { query } from "./choice.js";
import { $, afterPaint, changed, make, put } from "./elements.js";
import { fetchPast, trend, unit } from "./past.js";
import { AXES } from "./screens.js";
import { amount, clock, date, exact, sentence, time, word } from "./words.js";

let chart = null, course = null, axis = 2, zoomed = false, forecast = true, tolerance = null, visible = false;
// What the gateway has stored of before: thinned over the chosen span, and finer where somebody has zoomed in.
let past = null, fine = null, heats = null, pastTo = null, askedMs = -Infinity, marks = [], moment = null;
let asking = {}, askingHeat = 0;
const AGAIN_S = 1800, PATIENCE_MS = 60000;
const NO_PAST = { t: [], without: [[], [], []], half: [[], [], []], measured_t: [], measured: [[], [], []], measured_left: [[], [], []] };
const span = () => Number($("span").value) * 3600;
const fail = (to, why) => put($("past-problem"), why ? word("chart.no_past").replace("{at}", time(to * 1e3)).replace("{why}", () => why) : "");
// Undefined: the same has been asked for anew meanwhile.
const ask = async (what, from, to) => {
  const own = asking[what] = {}, { found, why } = await fetchPast(from, to);
  if (own !== asking[what]) return undefined;
  fail(to, why);
  return found;
};
const began = () => course && course.t.length ? course.t[0] : Date.now() / 1e3;
const ended = () => course && course.t.length ? course.t.at(-1) : Date.now() / 1e3;
const loadPast = async () => {
  const to = began(), from = ended() - span();
  fine = null;
  pastTo = to;
  askedMs = performance.now();
  asking = {};
  const wanted = to - from > 300, found = wanted ? await ask("span", from, to) : null;
  if (found === undefined) return;
  put($("stored-since"), found?.t.length && found.t[0] - from > 0.05 * span() ? word("chart.stored_since").replace("{at}", time(found.t[0] * 1e3)) : "");
  if (found || !wanted) past = found; else if (pastTo === to) pastTo = null;
  redraw();
};
const loadHeat = async (from, to) => {
  if (!chosen.size) return;
  const own = ++askingHeat, { found } = await fetchPast(from, to, "temperatures");
  if (own !== askingHeat || !found) return;
  heats = found;
  redraw();
};
const refine = async (min, max) => {
  loadHeat(min, Math.min(max, ended()));
  const to = Math.min(max, began());
  if (!past || to - min < 300) return;
  const found = await ask("zoom", min, to);
  if (found) { fine = { ...found, min, to }; redraw(); }
};
const pick = (p, keep, keepDots) => {
  const at = p.t.flatMap((t, j) => keep(t) ? [j] : []), dots = p.measured_t.flatMap((t, j) => keepDots(t) ? [j] : []);
  return { t: at.map((j) => p.t[j]), without: p.without.map((c) => at.map((j) => c[j])), half: p.half.map((c) => at.map((j) => c[j])),
    measured_t: dots.map((j) => p.measured_t[j]), measured: p.measured.map((c) => dots.map((j) => c[j])), measured_left: p.measured_left.map((c) => dots.map((j) => c[j] ?? null)) };
};
const joined = (a, b) => ({ t: [...a.t, ...b.t], measured_t: [...a.measured_t, ...b.measured_t],
  ...Object.fromEntries(["without", "half", "measured", "measured_left"].map((of) => [of, a[of].map((c, i) => [...c, ...b[of][i]])])) });
// What the page has heard itself stands in front of what is stored, and what is finer in place of what is coarse.
const before = () => {
  if (!past) return NO_PAST;
  const oldest = began() - 1, dot = course.measured_t.length ? course.measured_t[0] - 1 : Infinity;
  if (!fine) return pick(past, (t) => t < oldest, (t) => t < dot);
  const earlier = (most) => (t) => t < Math.min(fine.min, most), within = (most) => (t) => t >= fine.min && t < fine.to && t < most;
  const later = (most) => (t) => t >= fine.to && t < most;
  return [[past, earlier], [fine, within], [past, later]].map(([p, keep]) => pick(p, keep(oldest), keep(dot))).reduce(joined);
};

// The series of each name; a line comes after the edges of its band, or the band would cover it.
const GROUPS = { without: [1, 2, 3, 8, 9, 10], left: [4, 5, 6, 11, 12, 13, 14], interval: [1, 2, 4, 5, 8, 9, 11, 12], measured: [7], ahead: [8, 9, 10, 11, 12, 13], events: [] };
const off = new Set(), chosen = new Set();
const TOOL = 14;
const seen = (i) => !Object.entries(GROUPS).some(([name, own]) => off.has(name) && own.includes(i));
const columns = () => {
  const { t, without, left, half, measured_t, measured, ahead, ahead_left, ahead_half, ahead_left_half } = course, old = before(), i = axis;
  const edge = (values, halves, sign) => values.map((v, j) => v === null || halves[j] === null ? null : v + sign * halves[j]);
  const line = [...old.without[i], ...without[i]], wide = [...old.half[i], ...half[i]], rest = [...old.t.map(() => null), ...left[i]];
  const banded = (values, halves) => [edge(values, halves, -1), edge(values, halves, 1), values];
  const later = forecast ? [...banded(ahead[i], ahead_half[i]), ...banded(ahead_left[i], ahead_left_half[i])] : [[], [], [], [], [], []];
  const first = old.t[0] ?? t[0] ?? 0;
  const heard = [...chosen].map((channel) => {
    const [at, values] = trend(channel, heats), kept = at.flatMap((each, j) => each >= first ? [j] : []);
    return [kept.map((j) => at[j]), kept.map((j) => values[j])];
  });
  // All of the chosen span is there, also what nothing is stored of.
  const from = ended() - span(), none = old.t[0] === undefined || old.t[0] > from ? [null] : [];
  return uPlot.join([[[...none.map(() => from), ...old.t, ...t], ...[...banded(line, wide), ...banded(rest, wide)].map((column) => [...none, ...column])],
    [[...old.measured_t, ...measured_t], [...old.measured[i], ...measured[i]]], [forecast ? course.ahead_t : [], ...later], [old.measured_t, old.measured_left[i]], ...heard]);
};
// The value of a series nearest to one of the joined times, and not farther from it than this share of what is shown.
const NEAR = 0.03;
const near = (u, s, j) => {
  const [t] = u.data, values = u.data[s], far = NEAR * (u.scales.x.max - u.scales.x.min);
  for (let by = 0; by < 40; by++) for (const k of [j - by, j + by]) if (values[k] !== null && values[k] !== undefined && Math.abs(t[k] - t[j]) <= far) return values[k];
  return null;
};

const go = (min, max) => {
  const all = chart.data[0], least = ended() - 183 * 86400, wide = Math.max(max - min, 60);
  const from = Math.min(Math.max(min, least), all.at(-1) - wide);
  chart.setScale("x", { min: Math.max(from, least), max: Math.max(from, least) + wide });
};
const HELD = (u, at, by) => { const { min, max } = u.scales.x; return [at - (at - min) * by, at + (max - at) * by]; };
const whole = () => chart && chart.setScale("x", { min: chart.data[0][0], max: chart.data[0].at(-1) });
const within = (u, from, to) => [Math.max(from, u.data[0][0]), Math.min(to, u.data[0].at(-1))];
const ZOOM = 2;
const pointAt = (u, j) => u.setCursor({ left: u.valToPos(u.data[0][j], "x"), top: u.over.clientHeight / 2 });
// By keyboard: arrows move the cursor, + and - zoom at it, PageUp and PageDown go back and forth, Home shows everything.
const shift = (u, widths) => { const { min, max } = u.scales.x; go(min + (max - min) * widths, max + (max - min) * widths); };
const zoomAt = (u, j, by) => { const [from, to] = within(u, ...HELD(u, u.data[0][j], by)); u.setScale("x", { min: from, max: to }); pointAt(u, j); };
const KEYS = {
  ArrowLeft: (u, j, [first]) => pointAt(u, Math.max(j - 1, first)), ArrowRight: (u, j, [, last]) => pointAt(u, Math.min(j + 1, last)),
  "+": (u, j) => zoomAt(u, j, 1 / ZOOM), "-": (u, j) => zoomAt(u, j, ZOOM), Enter: (u, j) => choose(u.data[0][j]),
  PageUp: (u) => shift(u, -1 / ZOOM), PageDown: (u) => shift(u, 1 / ZOOM), Home: whole,
};
const press = (event) => {
  const u = chart, key = event.key, shown = u && u.series[0].idxs;
  if (!shown || !Object.hasOwn(KEYS, key) || event.ctrlKey || event.altKey || event.metaKey || u.data[0].length < 2) return;
  event.preventDefault();
  const j = u.cursor.idx;
  KEYS[key](u, j ?? shown[1], shown);
};
const wheel = (u, event) => {
  if (u.data[0].length < 2) return;
  event.preventDefault();
  const by = event.deltaX || (event.shiftKey ? event.deltaY : 0);
  if (by) { shift(u, by / u.over.clientWidth); return; }
  const at = u.posToVal(event.clientX - u.over.getBoundingClientRect().left, "x");
  go(...within(u, ...HELD(u, at, event.deltaY > 0 ? 1.25 : 0.8)));
};
// One finger moves the chart, two zoom it.
const fingers = new Map();
const touch = (u, event) => {
  if (event.pointerType !== "touch" || !fingers.has(event.pointerId)) return;
  const old = [...fingers.values()];
  fingers.set(event.pointerId, event.clientX);
  const now = [...fingers.values()], value = (x) => u.posToVal(x - u.over.getBoundingClientRect().left, "x");
  if (now.length === 1) { shift(u, (old[0] - now[0]) / u.over.clientWidth); return; }
  const wide = (each) => Math.max(Math.abs(each[0] - each[1]), 10), middle = (now[0] + now[1]) / 2;
  go(...within(u, ...HELD(u, value(middle), wide(old) / wide(now))));
};
let refining = 0;
const follow = (u, key) => {
  if (key !== "x") return;
  const { min, max } = u.scales.x, all = u.data[0];
  zoomed = all.length > 1 && (min > all[0] || max < all.at(-1));
  clearTimeout(refining);
  if (zoomed) refining = setTimeout(refine, 300, min, max);
};

const told = [];
// Calls `tell` with each moment that somebody chooses, UTC seconds; null: the present. There is an estimate of it.
export const onMoment = (tell) => told.push(tell);
const choose = (t) => {
  const estimated = t !== null && t <= ended() ? [before(), course].flatMap((p) => p.t.filter((_, j) => p.without.every((c) => c[j] !== null))) : [];
  moment = estimated.length ? estimated.reduce((a, b) => (Math.abs(b - t) < Math.abs(a - t) ? b : a)) : null;
  told.forEach((tell) => tell(moment));
  if (chart) { chart.redraw(false); read(); }
};
const PAIRS = [["left", 6, 5], ["left_measured", 14, null], ["without", 3, 2], ["measured", 7, null]], AHEAD = [["left", 13, 12], ["without", 10, 9]];
const read = () => {
  const u = chart, fixed = moment !== null && u ? u.valToIdx(moment) : null, j = u && (u.cursor.idx ?? fixed ?? u.valToIdx(ended()));
  if (!u || j === null || j === undefined || !u.data[0].length) return;
  const t = u.data[0][j], later = t > ended() + 1;
  put($("reading-title"), `${AXES[axis]} · ${time(t * 1e3)}${later ? ` · ${word("chart.ahead")}` : ""}`);
  const um = (n, sign) => amount({ n, u: "", d: 1, sign }), nearest = [7, 14], rows = [];
  for (const [name, s, high] of later ? AHEAD : PAIRS) {
    const v = nearest.includes(s) ? u.data[s][j] : near(u, s, j), edge = high && near(u, high, j);
    if (v === null || v === undefined) continue;
    rows.push([word("chart." + name), um(v, true) + (edge !== null && edge !== undefined ? ` ± ${um(edge - v)}` : "") + "\u202fµm"]);
  }
  [...chosen].forEach((channel, i) => rows.push([channel, amount({ n: near(u, TOOL + 1 + i, j), u: unit(channel), d: 1 })]));
  if (!changed("reading", rows)) return;
  $("reading").replaceChildren(...rows.map(([name, value]) => {
    const row = make("div");
    row.append(make("dt", name), make("dd", value));
    return row;
  }));
};

const INKS = ["c1", "c2", "c3", "c4", "c5", "c6"], DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3]];
const dressed = (i) => [INKS[i % INKS.length], DASHES[Math.floor(i / INKS.length) % DASHES.length]];
const draw = () => {
  const place = $("chart");
  if (chart) chart.destroy();
  chart = null;
  if (!visible || !course || !(course.t.length || past) || !place.clientWidth) return;
  const style = getComputedStyle(document.documentElement), rem = (n) => Math.round(n * parseFloat(style.fontSize)), font = `${rem(0.85)}px system-ui, sans-serif`, ink = (name) => style.getPropertyValue("--" + name).trim();
  const base = { stroke: ink("soft"), ticks: { show: false }, font }, grid = { stroke: ink("line"), width: 1 };
  const line = (colour, more) => ({ stroke: ink(colour), width: 2, points: { show: false }, spanGaps: true, ...more });
  const edge = { stroke: "transparent", width: 0, points: { show: false }, spanGaps: true };
  const loose = { ...edge, auto: false };  // what was foreseen may be anywhere: it does not make the rest small
  const units = [...new Set([...chosen].map(unit))], padded = (least) => ({ range: (_, min, max) => { const pad = Math.max((max - min) * 0.08, least); return [min - pad, max + pad]; } });
  const series = [{}, edge, edge, line("before"), edge, edge, line("after", { width: 2.5, spanGaps: false }),
    line("measured", { paths: () => null, points: { show: true, size: 8, fill: ink("measured"), stroke: ink("panel") } }),
    loose, loose, line("before", { dash: [2, 5] }), loose, loose, line("after", { dash: [2, 5], width: 2.5 }),
    line("after", { paths: () => null, points: { show: true, size: 7, fill: ink("after"), stroke: ink("panel") } }),
    ...[...chosen].map((channel, i) => line(dressed(i)[0], { dash: dressed(i)[1], width: 1.8, scale: "u" + units.indexOf(unit(channel)) }))]
    .map((each, i) => ({ ...each, label: String(i), show: i === 0 || seen(i) }));
  chart = new uPlot({
    width: place.clientWidth, height: place.clientHeight,
    padding: [10, units.length ? 0 : 28, 0, 0],
    axes: [{ ...base, grid, size: rem(1.9), space: rem(5), values: (_, all, __, ___, step) => all.map((v) => (step < 86400 ? clock : date).format(new Date(v * 1e3))) },
      { ...base, grid, size: rem(3.25), space: 44, label: `${AXES[axis]}, µm`, labelSize: rem(1.3), labelFont: font, values: (_, all) => all.map((v) => amount({ n: v, d: v % 1 ? 1 : 0 })) },
      ...units.slice(0, 2).map((each, i) => ({ ...base, grid: { show: false }, scale: "u" + i, side: 1, size: rem(3.25), space: 44, label: each, labelSize: rem(1.3), labelFont: font, values: (_, all) => all.map((v) => amount({ n: v, d: v % 1 ? 1 : 0 })) }))],
    scales: { y: { range: (_, min, max) => { const t = tolerance && tolerance < 3 * (max - min) ? 1.1 * tolerance : 0, low = Math.min(min, -t), high = Math.max(max, t), pad = Math.max((high - low) * 0.06, 1); return [low - pad, high + pad]; } }, ...Object.fromEntries(units.map((each, i) => ["u" + i, padded(0.5)])) },
    series,
    bands: [[2, 1, "band"], [5, 4, "left-band"], [9, 8, "band"], [12, 11, "left-band"]].map(([high, low, fill]) => ({ series: [high, low], fill: ink(fill) })),
    legend: { show: false },
    cursor: { drag: { x: true, y: false }, points: { size: 9 } },
    hooks: { setScale: [follow], setCursor: [read], drawClear: [(u) => ground(u, ink)], draw: [(u) => overlay(u, ink)],
      ready: [(u) => {
        u.over.addEventListener("wheel", (event) => wheel(u, event), { passive: false });
        u.over.addEventListener("click", () => { if (u.cursor.idx !== null && !u.select.width) choose(u.data[0][u.cursor.idx]); });
        u.over.addEventListener("pointerdown", (event) => { if (event.pointerType === "touch") fingers.set(event.pointerId, event.clientX); });
        u.over.addEventListener("pointermove", (event) => touch(u, event));
        for (const kind of ["pointerup", "pointercancel", "pointerleave"]) u.over.addEventListener(kind, (event) => fingers.delete(event.pointerId));
      }] },
  }, columns(), place);
  if (zoomed && kept) chart.setScale("x", kept);
  read();
};
let kept = null;
const bounds = ({ bbox: { left, top, width, height } }) => [left, top, left + width, top + height];
// The tolerance lies under the curves.
const ground = (u, ink) => {
  const [left, , right] = bounds(u), { ctx } = u;
  if (!tolerance) return;
  const y = (v) => Math.min(Math.max(u.valToPos(v, "y", true), u.bbox.top), u.bbox.top + u.bbox.height);
  ctx.save();
  ctx.fillStyle = ink("zone");
  ctx.fillRect(left, y(tolerance), right - left, y(-tolerance) - y(tolerance));
  ctx.restore();
};
const LANE = 8;
// Over them: its limits, the present, the chosen moment, the verdict's colours and the events.
const overlay = (u, ink) => {
  const [left, top, right, bottom] = bounds(u), { ctx } = u, px = devicePixelRatio, x = (t) => u.valToPos(t, "x", true), { min, max } = u.scales.x;
  ctx.save();
  ctx.beginPath();
  ctx.rect(left, top, right - left, bottom - top);
  ctx.clip();
  const line = (x0, y0, x1, y1, colour, width, dash = []) => {
    ctx.beginPath(); ctx.setLineDash(dash); ctx.strokeStyle = ink(colour); ctx.lineWidth = width * px; ctx.moveTo(x0, y0); ctx.lineTo(x1, y1); ctx.stroke();
  };
  for (const t of tolerance ? [-tolerance, tolerance] : []) {
    const y = u.valToPos(t, "y", true), text = amount({ n: t, d: t % 1 ? 1 : 0, sign: true });
    line(left, y, right, y, "ink", 1.2);
    ctx.font = `600 ${13 * px}px system-ui, sans-serif`;
    ctx.textAlign = "left";
    ctx.textBaseline = t > 0 ? "bottom" : "top";
    ctx.fillStyle = ink("ink");
    ctx.fillText(t > 0 ? `${word("chart.tolerance")} ${text}` : text, left + 5 * px, y);
  }
  course.state.forEach((colour, i) => {
    const to = course.t[i + 1] ?? course.t[i];
    if (to < min || course.t[i] > max || to - course.t[i] > 3600) return;
    ctx.fillStyle = ink(colour);
    ctx.fillRect(x(course.t[i]), bottom - LANE * px, x(to) - x(course.t[i]) + 1, LANE * px);
  });
  if (forecast && course.ahead_t.length) line(x(ended()), top, x(ended()), bottom, "ink", 1.5);
  if (!off.has("events")) for (const [at, mark] of [...past?.marks ?? [], ...fine?.marks ?? [], ...marks].filter(([t]) => t >= min && t <= max)) {
    ctx.fillStyle = ink(mark === "bad" ? "bad" : "note");
    ctx.beginPath();
    ctx.moveTo(x(at) - 5 * px, bottom - (LANE + 12) * px); ctx.lineTo(x(at) + 5 * px, bottom - (LANE + 12) * px); ctx.lineTo(x(at), bottom - (LANE + 2) * px);
    ctx.fill();
  }
  if (moment !== null) line(x(moment), top, x(moment), bottom, "focus", 2, [5 * px, 4 * px]);
  ctx.restore();
};

const redraw = () => {
  if (!course) return;
  if (!chart) { if (visible) afterPaint(() => { if (!chart) draw(); }); return; }
  const { min, max } = chart.scales.x;
  chart.setData(columns(), !zoomed);
  if (zoomed) chart.setScale("x", { min, max });
  read();
};
const again = () => { kept = chart ? { min: chart.scales.x.min, max: chart.scales.x.max } : null; draw(); };
// What was foreseen does not hold while nobody knows what has come.
export const keepForecast = (now) => {
  if (forecast === now) return;
  forecast = now;
  redraw();
};
export const showCourse = (c) => {
  course = c;
  put($("chart-note"), c.said ? sentence(c.said) : "");
  redraw();
  // What it has heard itself moves on after eight hours; a gateway that did not answer may have come back.
  if (pastTo === null ? performance.now() - askedMs > PATIENCE_MS : Math.abs(began() - pastTo) > AGAIN_S) loadPast();
};
export const showMarks = (events) => {
  marks = events.filter((e) => e.mark === "bad" || e.mark === "notice").map((e) => [Date.parse(e.t) / 1e3, e.mark]);
  if (chart) chart.redraw(false);
};
export const keepTolerance = (um) => {
  if (tolerance === um) return;
  tolerance = um;
  if (chart) chart.redraw(false);
};
// Whatever is known was said of another point of the tool.
export const forgetCourse = () => { zoomed = false; course = null; past = null; fine = null; pastTo = null; askedMs = -Infinity; };

// The channels that may be drawn, and those that are.
const offer = (channels) => {
  if (!changed("series", [channels, [...chosen], [...off], axis])) return;
  const box = (name, text, checked, ink, change) => {
    const label = make("label", undefined, "series-choice"), input = make("input"), swatch = make("i", undefined, ink ?? "none");
    input.type = "checkbox";
    input.name = name;
    input.checked = checked;
    input.addEventListener("change", change);
    label.append(input, swatch, text);
    return label;
  };
  const tool = Object.keys(GROUPS).map((name) => box(name, word("chart." + name), !off.has(name), `ink-${name}`, () => {
    if (off.has(name)) off.delete(name); else off.add(name);
    again();
  }));
  const order = [...chosen];
  const others = channels.map((channel) => box(channel, channel, chosen.has(channel), chosen.has(channel) ? `ink-${dressed(order.indexOf(channel))[0]}` : null, () => toggle(channel)));
  const focused = document.activeElement?.name, place = $("series");
  place.replaceChildren(...tool, ...others);
  if (focused) place.querySelector(`[name="${CSS.escape(focused)}"]`)?.focus();
};
let names = [];
const toggle = (channel) => {
  if (chosen.has(channel)) chosen.delete(channel); else chosen.add(channel);
  offer(names);
  again();
  loadHeat(chart && zoomed ? chart.scales.x.min : ended() - span(), ended());
};
// A gateway that has just begun again has not told its loads yet.
export const showSeries = (inputs) => {
  names = [...new Set([...names, ...inputs.map((c) => c.channel)])].sort();
  offer(names);
};
// Only this channel, and its neighbours, beside the errors at the tool.
export const showChannel = (channel, neighbours) => {
  chosen.clear();
  for (const each of [channel, ...neighbours].filter((name) => names.includes(name))) chosen.add(each);
  offer(names);
  again();
  loadHeat(chart && zoomed ? chart.scales.x.min : ended() - span(), ended());
};

const save = (name, type, body) => {
  const link = make("a"), url = URL.createObjectURL(body instanceof Blob ? body : new Blob([body], { type }));
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(URL.revokeObjectURL, 10e3, url);
};
const fileName = (end) => `${document.body.dataset.machine}-${AXES[axis]}-${new Date(chart.scales.x.min * 1e3).toISOString().slice(0, 16).replace(/[:T]/g, "")}.${end}`;
const HEADINGS = ["without_low_um", "without_high_um", "without_um", "left_low_um", "left_high_um", "left_um", "measured_um",
  "forecast_without_low_um", "forecast_without_high_um", "forecast_without_um", "forecast_left_low_um", "forecast_left_high_um", "forecast_left_um", "left_measured_um"];
const quoted = (text) => `"${text.replaceAll('"', '""')}"`;
// What is seen: the shown series within the shown span.
const saveCsv = () => {
  const { min, max } = chart.scales.x, shown = chart.series.flatMap((each, i) => i && each.show ? [i] : []);
  const heading = ["time_utc", ...shown.map((i) => i <= TOOL ? HEADINGS[i - 1] : quoted(`${[...chosen][i - TOOL - 1]} ${unit([...chosen][i - TOOL - 1])}`.trim()))];
  const lines = chart.data[0].flatMap((t, j) => t < min || t > max ? [] : [[new Date(t * 1e3).toISOString(), ...shown.map((i) => chart.data[i][j] ?? "")].join(",")]);
  save(fileName("csv"), "text/csv", [heading.join(","), ...lines, ""].join("\r\n"));
};
const savePng = () => {
  const from = chart.root.querySelector("canvas"), to = document.createElement("canvas"), ctx = to.getContext("2d"), line = 26 * devicePixelRatio;
  [to.width, to.height] = [from.width, from.height + line];
  ctx.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--panel");
  ctx.fillRect(0, 0, to.width, to.height);
  ctx.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--ink");
  ctx.font = `${15 * devicePixelRatio}px system-ui, sans-serif`;
  const { min, max } = chart.scales.x, day = (t) => `${date.format(new Date(t * 1e3))} ${exact.format(new Date(t * 1e3))}`;
  ctx.fillText(`${document.body.dataset.machine} · ${AXES[axis]}, µm · ${day(min)} – ${day(max)}${query() ? ` · ${query()}` : ""}`, 10, 18 * devicePixelRatio);
  ctx.drawImage(from, 0, line);
  to.toBlob((blob) => save(fileName("png"), "image/png", blob));
};
// shown: what the screens show
export const showScreen = (shown) => {
  visible = shown.sees("time");
  axis = AXES.indexOf(shown.axis);
  if (changed("screen", [visible, axis, shown.printed])) again();
};
export const readyChart = () => {
  $("chart").addEventListener("keydown", press);
  $("span").addEventListener("change", () => { zoomed = false; loadPast(); loadHeat(ended() - span(), ended()); });
  $("whole").addEventListener("click", () => { whole(); choose(null); });
  $("csv").addEventListener("click", () => { if (chart) saveCsv(); });
  $("png").addEventListener("click", () => { if (chart) savePng(); });
  new ResizeObserver(() => {
    const place = $("chart");
    if (chart && place.clientWidth && (chart.width !== place.clientWidth || chart.height !== place.clientHeight)) chart.setSize({ width: place.clientWidth, height: place.clientHeight });
    else if (!chart) redraw();
  }).observe($("chart"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
};

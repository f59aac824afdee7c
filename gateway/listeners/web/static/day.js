// Where the micrometres at the tool came from over the last day: what each part of the machine moved, reason after reason.
import { machine } from "./choice.js";
import { $, afterPaint, changed, drawn, make, put } from "./elements.js";
import { fetchPast } from "./past.js";
import { AXES } from "./screens.js";
import { amount, answerTo, time, word } from "./words.js";
import { allInks, axisRow, errorsThen, giveInks, inkOf, SINCE } from "./why.js";

const SPAN_S = 86400, LONGEST_S = 2 * 3600, MOST_ASKED = 4, PATIENCE_MS = 60e3, AGAIN_MS = 600e3, SOONEST_S = 1;
// Reasons by grid index: { t, lines }
const known = new Map();
let view = null, asked = 0, oldest = null, asking = false, againMs = 0, course = null, past = null, pastMs = -Infinity;
const keep = (lines) => {
  for (const c of lines) {
    if (!known.has(c.k)) known.set(c.k, { t: Date.parse(c.t) / 1e3, lines: new Map() });
    known.get(c.k).lines.set(c.error, c);
  }
};
const now = () => Date.parse(view.gateway_time) / 1e3;
// The errors without compensation as the chart has them, each with the last reasons before it; what has changed since
// these is a part by itself: the parts add up to the error at any time.
const steps = () => {
  const heard = course?.t ?? [], first = heard[0] ?? Infinity, from = now() - SPAN_S, stored = past ? past.t.flatMap((t, j) => t < first && t >= from ? [j] : []) : [];
  const t = [...stored.map((j) => past.t[j]), ...heard], of = AXES.map((_, i) => [...stored.map((j) => past.without[i][j]), ...(course?.without[i] ?? [])]);
  const gaps = t.slice(1).map((end, j) => end - t[j]).sort((a, b) => a - b), longest = 3 * (gaps[gaps.length >> 1] ?? 0);
  const reasons = [...known.values()].sort((a, b) => a.t - b.t).map(({ t: at, lines }) => ({ t: at, rows: AXES.map((_, i) => axisRow(errorsThen([...lines.values()]), i)) }));
  let last = -1;
  return t.flatMap((at, j) => {
    while (last + 1 < reasons.length && reasons[last + 1].t <= at + SOONEST_S) last++;
    const total = of.map((column) => column[j]), told = last >= 0 && at - reasons[last].t <= LONGEST_S ? reasons[last].rows : AXES.map(() => ({ parts: [], total: 0 }));
    if (at < from || total.includes(null)) return [];
    return [{ from: at, to: Math.min(t[j + 1] ?? now(), at + longest), total, rows: told.map(({ parts, total: then }, i) => [...parts, { key: SINCE, n: total[i] - then }]) }];
  });
};
const swing = (values) => Math.max(0, ...values) - Math.min(0, ...values);
// By part: its name, and what it moved in X, Y and Z at each step. Those that moved most have a colour, all others are one.
const parts = (shown) => {
  const found = new Map();
  shown.forEach(({ rows }, j) => AXES.forEach((_, i) => {
    for (const { key, n } of rows[i]) {
      if (!found.has(key)) found.set(key, AXES.map(() => shown.map(() => 0)));
      found.get(key)[i][j] += n;
    }
  }));
  const most = (moved) => Math.max(...moved.map(swing));
  giveInks("day", [...found].map(([key, moved]) => [key, most(moved)]));
  const own = [...found].filter(([key]) => inkOf(key)).sort((a, b) => most(b[1]) - most(a[1])), others = [...found].filter(([key]) => !inkOf(key) && key !== SINCE), since = found.get(SINCE);
  const sum = others.reduce((all, [, moved]) => all.map((axis, i) => axis.map((n, j) => n + moved[i][j])), AXES.map(() => shown.map(() => 0)));
  return [...own.map(([name, moved]) => ({ name, moved, ink: inkOf(name) })), ...(since ? [{ name: word("moves.between"), moved: since, ink: "since" }] : []), ...(others.length ? [{ name: word("moves.else"), moved: sum, ink: "rest" }] : [])];
};
const HEIGHT = 100;
const draw = (shown, list, i, [low, high]) => {
  const from = now() - SPAN_S, x = (t) => ((t - from) / SPAN_S * 1000).toFixed(1), y = (n) => ((high - n) / (high - low || 1) * HEIGHT).toFixed(1);
  const up = shown.map(() => 0), down = shown.map(() => 0), svg = drawn("svg", { viewBox: `0 0 1000 ${HEIGHT}`, preserveAspectRatio: "none", role: "img" });
  for (const { moved, ink } of list) {
    const path = shown.map((each, j) => {
      const n = moved[i][j], base = n > 0 ? up[j] : down[j];
      if (n > 0) up[j] += n; else down[j] += n;
      return n ? `M${x(each.from)} ${y(base)}H${x(each.to)}V${y(base + n)}H${x(each.from)}Z` : "";
    }).join("");
    svg.append(drawn("path", { d: path, class: `fill-${ink}` }));
  }
  svg.append(drawn("path", { d: `M0 ${y(0)}H1000`, class: "nought-line" }));
  svg.append(drawn("path", { d: shown.map((each, j) => `${j && each.from <= shown[j - 1].to ? "L" : "M"}${x(each.from)} ${y(each.total[i])}H${x(each.to)}`).join(""), class: "day-line" }));
  svg.setAttribute("aria-label", `${AXES[i]}: ` + list.map((p) => `${p.name} ${amount({ n: swing(p.moved[i]), u: "µm", d: 1 })}`).join(", "));
  return svg;
};
const show = () => {
  if (!view || !view.gateway_time) return;
  // Drawn again for new reasons, another point or the next minute, not for each message.
  if (!changed("day", [Math.floor(now() / 60), known.size, Math.max(...known.keys()), view.reach, past?.t.length, course?.t.at(-1), allInks()])) return;
  const shown = steps();
  $("day-empty").hidden = shown.length > 0;
  $("day-shown").hidden = !shown.length;
  if (!shown.length) return;
  const list = parts(shown), stacked = (sign) => AXES.flatMap((_, i) => shown.map((__, j) => list.reduce((all, p) => all + Math.max(sign * p.moved[i][j], 0), 0)));
  const ends = [-Math.max(...stacked(-1)), Math.max(...stacked(1))];
  $("day-axes").replaceChildren(...AXES.map((axis, i) => {
    const row = make("div", undefined, "day-axis"), scale = make("p", undefined, "note");
    scale.append(...ends.map((n) => make("span", -ends[0] < ends[1] / 4 && n < 0 ? "0" : amount({ n, d: 0, sign: true }))).reverse());
    row.append(make("h4", axis), scale, draw(shown, list, i, ends));
    return row;
  }));
  put($("day-from"), time((now() - SPAN_S) * 1e3));
  put($("day-to"), time(view.gateway_time));
  $("day-parts").tBodies[0].replaceChildren(...list.map(({ name, moved, ink }) => {
    const row = make("tr"), head = make("th", undefined);
    head.scope = "row";
    head.append(make("i", undefined, `ink-${ink}`), name);
    row.append(head, ...moved.map((values) => make("td", amount({ n: swing(values), d: 1 }), "right")));
    return row;
  }));
};
const fetchMore = async () => {
  if (asking || !view.gateway_time || oldest !== null && oldest < now() - SPAN_S || asked >= MOST_ASKED || performance.now() < againMs) return;
  asking = true;
  const before = oldest === null ? now() : oldest;
  const { ok, told: found } = await answerTo(`/corrections/${encodeURIComponent(machine)}?before=${encodeURIComponent(new Date(before * 1e3).toISOString())}`);
  asking = false;
  if (!ok || found.why) { againMs = performance.now() + PATIENCE_MS; return; }
  asked++;
  keep(found.lines);
  oldest = found.before ? Date.parse(found.before) / 1e3 : -Infinity;
  show();
  fetchMore();
};
export const takeCourse = (c) => { course = c; show(); };
// What the chart shows of before this page's program listened.
const fetchErrors = async () => {
  if (!view.gateway_time || performance.now() - pastMs < AGAIN_MS) return;
  pastMs = performance.now();
  past = (await fetchPast(now() - SPAN_S, now())).found ?? past;
  show();
};
export const takeDay = (lines) => {
  keep(lines);
  for (const [k, { t }] of known) if (view && view.gateway_time && t < now() - SPAN_S - LONGEST_S) known.delete(k);
  show();
};
export const showDay = (v) => { view = v; show(); afterPaint(() => { fetchMore(); fetchErrors(); }); };

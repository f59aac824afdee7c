// What moved each error: stacked bars that add up, of now or of a moment that somebody has chosen.
import { machine } from "./choice.js";
import { $, changed, make, piece, put } from "./elements.js";
import { onMoment } from "./chart.js";
import { fetchPast } from "./past.js";
import { AXES } from "./screens.js";
import { amount, answerTo, time, word } from "./words.js";

export const REST = "";
export const SINCE = ">";
const LEVEL = "=";
let latest = null, axis = "Z", moment = null, then = null, thenAt = null;
// When the reasons were given that are being drawn.
let reasonsAt = null;
const tenths = (n) => Math.round(n * 10) / 10;
// Rounded parts that add up to the rounded sum: what rounding leaves goes to the rest.
const even = (parts, total) => {
  const own = parts.map((p) => ({ ...p, n: tenths(p.n) })), rest = own.find((p) => p.key === REST), gap = tenths(tenths(total) - own.reduce((sum, p) => sum + p.n, 0));
  if (rest) rest.n = tenths(rest.n + gap); else if (gap) own.push({ key: REST, n: gap });
  return own.filter((p) => p.n);
};
const named = (key) => key === REST ? word("heat.others") : key === LEVEL ? word("heat.level") : key === SINCE ? word("moves.since").replace("{at}", time(reasonsAt)) : key;
const OWN = [REST, LEVEL, SINCE], KINDS = { [REST]: "rest", [LEVEL]: "level", [SINCE]: "since" };
// The largest first, and then what is no input.
const ranked = (parts) => [...parts].sort((a, b) => OWN.includes(a.key) - OWN.includes(b.key) || Math.abs(b.n) - Math.abs(a.n));
// Each part has one colour, wherever it is drawn; those that moved most come first, and what is left over has none.
export const INKS = ["c1", "c2", "c3", "c4", "c6"];
const inks = new Map(), sizes = {};
export const inkOf = (key) => inks.get(key);
// Five parts have their colours always, in each language and browser; others have the colours that are left, and keep them.
const OWN_INKS = new Map(["column", "spindle", "cradle", "slides", "table"].map((part, i) => [word("body." + part), INKS[i]]));
// found: parts and how much they move, now or over the day. What moves most now comes first, so that a minute is told
// alike whether or not the day is known; whoever has a colour and still counts keeps it.
export const giveInks = (of, found) => {
  sizes[of] = new Map();
  for (const [key, n] of found) if (!OWN.includes(key)) sizes[of].set(key, Math.max(sizes[of].get(key) ?? 0, Math.abs(n)));
  const all = Object.values(sizes), size = (key) => Math.max(...all.map((each) => each.get(key) ?? 0));
  const before = String([...inks]), inNow = (key) => (sizes.now?.get(key) ?? 0) >= 0.05;
  const first = [...new Set(all.flatMap((each) => [...each.keys()]))].sort((a, b) => inNow(b) - inNow(a) || (inNow(a) ? sizes.now.get(b) - sizes.now.get(a) : size(b) - size(a))).slice(0, INKS.length);
  const taken = new Set(first.filter((key) => OWN_INKS.has(key)).map((key) => OWN_INKS.get(key)));
  for (const [key, ink] of [...inks]) if (!first.includes(key) || (!OWN_INKS.has(key) && taken.has(ink))) inks.delete(key);
  for (const key of first) if (OWN_INKS.has(key)) inks.set(key, OWN_INKS.get(key));
  for (const key of first) if (!inks.has(key)) inks.set(key, INKS.find((ink) => ![...inks.values()].includes(ink)));
  if (of !== "now" && String([...inks]) !== before) queueMicrotask(show);
};
export const allInks = () => [...inks];
const dressed = (shown, p) => {
  const ink = inkOf(p.part ? word("body." + p.part) : p.key);
  shown.classList.add(OWN.includes(p.key) ? KINDS[p.key] : ink ? `ink-${ink}` : "plain");
  return shown;
};
// rows: [{ name, note, unit, total, parts: [{ key, n, part }], said }]; all on one scale for each unit. said: instead of parts
const stacks = (rows) => {
  const ends = {};
  for (const { unit, parts } of rows) {
    const [low, high] = ends[unit] ?? [0, 0], sum = (sign) => parts.filter((p) => p.n * sign > 0).reduce((all, p) => all + p.n, 0);
    ends[unit] = [Math.min(low, sum(-1)), Math.max(high, sum(1))];
  }
  return rows.map(({ name, note, unit, total, parts, key, said: why }) => {
    const row = make("div", undefined, "stack"), track = make("div", undefined, "track"), [low, high] = ends[unit], wide = high - low || 1;
    const at = (n) => (n - low) / wide * 100;
    let up = 0, down = 0;
    for (const p of [...parts].sort((a, b) => Math.abs(b.n) - Math.abs(a.n))) {
      const from = p.n > 0 ? up : down + p.n, to = from + Math.abs(p.n), shown = dressed(piece("share", at(from), at(to)), p);
      if (to - from > 0.15 * wide) shown.append(make("b", named(p.key)));
      shown.title = `${named(p.key)} ${amount({ n: p.n, u: unit, d: 1, sign: true })}`;
      if (p.n > 0) up = to; else down = from;
      track.append(shown);
    }
    if (!why) track.append(piece("nought", at(0)), piece("sum", at(total)));
    const said = make("p", why, "parts");
    said.append(...ranked(parts).flatMap((p, i) => {
      const part = make("span", `${named(p.key)}\u00a0${amount({ n: p.n, d: 1, sign: true })}`, "part-of");
      part.prepend(dressed(make("i", undefined, "share"), p));
      return [i ? " " : "", part];
    }));
    track.setAttribute("aria-hidden", "true");
    const title = make("h4", name);
    if (note) title.append(" ", make("small", note));
    row.append(title, track, make("p", amount({ n: why ? null : total, u: unit, d: 1, sign: true }), "total number"), said);
    if (key) row.dataset.key = key;
    return row;
  });
};
// As `driven` tells of the last reasons, with what has changed since, and the corrections of a moment.
const errorsNow = ({ driven, errors }) => driven.map((e) => {
  if (!e.corrected) return { error: e.error, total: 0, unit: e.estimate.u, parts: [], said: word("heat.not_corrected") };
  const total = errors[e.error] ?? e.estimate.n;
  return { error: e.error, total, unit: e.estimate.u, parts: [...e.movers.map(([key, by]) => ({ key, n: by.n })),
    { key: REST, n: e.others.n }, { key: LEVEL, n: e.level.n }, { key: SINCE, n: total - e.estimate.n }] };
});
export const errorsThen = (lines) => lines.map((c) => ({ error: c.error, total: c.estimate.n, unit: c.estimate.u,
  parts: [...c.movers.map(([key, by]) => ({ key, n: by.n })), { key: REST, n: c.rest.n - c.level.n }, { key: LEVEL, n: c.level.n }] }));
// The errors of a moment, as `lines` tell of the last reasons before it, with what had changed since.
const errorsAt = (errors, lines) => Object.entries(errors).flatMap(([error, total]) => {
  const told = errorsThen(lines.filter((c) => c.error === error))[0] ?? { error, total: 0, unit: latest.driven.find((e) => e.error === error)?.estimate.u, parts: [] };
  return total === null || !total && !told.parts.length ? [] : [{ ...told, total, parts: [...told.parts, { key: SINCE, n: total - told.total }] }];
});
const bodyOf = (channel) => latest.channels.find((c) => c.channel === channel)?.body ?? "";
const errorRows = (errors) => errors.map((e) => ({ name: e.error, note: word("error." + e.error), unit: e.unit, total: tenths(e.total), key: e.error, said: e.said,
  parts: even(e.parts.map((p) => ({ ...p, part: bodyOf(p.key) })), e.total) }));
export const axisRow = (errors, i) => {
  const found = new Map();
  let total = 0;
  for (const e of errors) {
    const reach = latest.reach[e.error][i];
    total += reach * e.total;
    for (const p of e.parts) {
      const own = OWN.includes(p.key), part = own ? "" : bodyOf(p.key), key = own ? p.key : part ? word("body." + part) : p.key;
      const sum = found.get(key) ?? { key, part, n: 0 };
      sum.n += reach * p.n;
      found.set(key, sum);
    }
  }
  total = Math.round(total * 100) / 100;  // as in the chart
  return { name: AXES[i], unit: "µm", total: tenths(total), key: AXES[i], parts: even([...found.values()], total) };
};
// Parts that have no colour of their own are among the other inputs.
const folded = (row) => {
  const own = row.parts.filter((p) => p.key !== REST && (OWN.includes(p.key) || inkOf(p.key))), rest = tenths(row.total - own.reduce((sum, p) => sum + p.n, 0));
  return { ...row, parts: rest ? [...own, { key: REST, n: rest }] : own };
};
const worstOf = (rows) => rows.reduce((a, b) => (Math.abs(b.total) > Math.abs(a.total) ? b : a));
// Since when the error of one axis without compensation has been beyond the tolerance.
let course = null;
export const takeMoved = (c) => { course = c; };
const beyondSince = (axis, tolerance) => {
  const values = course?.without[AXES.indexOf(axis)] ?? [];
  let first = values.length;
  while (first && values[first - 1] !== null && Math.abs(values[first - 1]) > tolerance) first--;
  return first === values.length || !tolerance ? "" : word(first ? "moves.most_since" : "moves.most_before").replace("{at}", time(course.t[first] * 1e3));
};
// A correction that no longer follows is part of where they come from.
const standsStill = () => latest.axes.some((a) => a.left.n !== null) && latest.tool_notes.some((note) => note.say === "tool.not_following");
// The axis that is off most, or would be without compensation, by how much, by what, and since when; null: not known.
export const mostMoved = (tolerance) => {
  const rows = AXES.map((_, i) => axisRow(errorsNow(latest), i)), said = (n, u) => amount({ n: tenths(n), u, d: 1, sign: true });
  const off = standsStill() ? latest.axes.filter((a) => a.left.n !== null).reduce((a, b) => (a.far.n >= b.far.n ? a : b)) : null;
  const worst = off ? rows[AXES.indexOf(off.axis)] : worstOf(rows), first = ranked(worst.parts).find((p) => !OWN.includes(p.key));
  if (!first) return null;
  if (off) {
    const values = { axis: off.axis, left: said(off.left.n, "µm"), without: said(off.without.n), what: first.key, by: said(first.n), held: said(tenths(off.left.n) - tenths(off.without.n)) };
    return word("moves.left_said").replace(/\{(\w+)\}/g, (_, name) => values[name]);
  }
  const values = { since: beyondSince(worst.name, tolerance), axis: worst.name, total: said(worst.total, "µm"), what: first.key, by: said(first.n), rest: said(worst.total - first.n, "µm") };
  return word("moves.most_said").replace(/\{(\w+)\}/g, (_, name) => values[name]);
};
// Each axis now, with what moves it most, and since when one is out of tolerance, in one sentence; empty: not known.
export const eachMoved = (tolerance) => {
  if (standsStill()) return mostMoved(tolerance) ?? "";
  const rows = AXES.map((_, i) => axisRow(errorsNow(latest), i)), said = (n) => amount({ n, d: 1, sign: true });
  reasonsAt = latest.reasons;
  const moved = ({ name, total, parts }) => {
    const [most] = [...parts].sort((a, b) => Math.abs(b.n) - Math.abs(a.n)), what = most && (OWN.includes(most.key) ? named(most.key) : most.key.replaceAll(" ", "\u00a0"));
    return `${name}\u00a0${said(total)}${most ? ` (${what}\u00a0${said(most.n)})` : ""}`;
  };
  return rows.some((row) => row.parts.length) ? word("moves.each").replace("{since}", beyondSince(worstOf(rows).name, tolerance)).replace("{axes}", () => rows.map(moved).join(", ")) : "";
};
// A label that has no room in its bar is not there.
const fitLabels = () => { for (const label of document.querySelectorAll(".stack .share b")) label.classList.toggle("spare", label.offsetWidth > label.parentNode.clientWidth); };
const show = () => {
  if (!latest) return;
  const errors = moment === null ? errorsNow(latest) : then ?? [];
  const ofTool = (each) => each.length ? AXES.map((_, i) => axisRow(each, i)) : [], wholes = [latest.alive ? errorsNow(latest) : [], errors].map(ofTool), none = () => [make("p", word("heat.no_reasons"), "empty")];
  giveInks("now", wholes.flat().flatMap((row) => row.parts.map((p) => [p.key, p.n])));
  if (!changed("why", [moment, errors, latest.reach, axis, latest.alive, time(latest.gateway_time), allInks()])) return;
  const [now, rows] = wholes.map((each) => each.map(folded));
  reasonsAt = latest.reasons;
  $("now-why").replaceChildren(...(now.length ? stacks(now) : [make("p", word("tool.nothing"), "empty")]));
  $("now-keys").replaceChildren(...ranked([...new Map(now.flatMap((row) => row.parts).map((p) => [p.key, p])).values()]).map((p) => {
    const part = make("span", named(p.key), "part-of");
    part.prepend(dressed(make("i", undefined, "share"), p));
    return part;
  }));
  if (moment !== null) reasonsAt = thenAt;
  $("why-axes").replaceChildren(...(rows.length ? stacks(rows) : none()));
  fitLabels();
  $("drives").replaceChildren(...stacks(errorRows(errors)));
  $("drives-empty").hidden = errors.length > 0;
  $("moment-why").replaceChildren(...(rows.length ? stacks([rows[AXES.indexOf(axis)]]) : none()));
  const told = moment !== null ? moment * 1e3 : latest.alive ? null : latest.reasons;
  put($("why-moment"), told ? time(told) : "");
  const at = told && time(told);
  put($("moment-title"), word("moves.title") + (at ? ` · ${at}` : ""));
};
export const showWhy = (v) => {
  latest = v;
  show();
};
export const showAxis = (shown) => { axis = shown.axis; show(); };
const STEP_S = 1;
let asking = 0;
const follow = async (t) => {
  const own = ++asking;
  moment = t;
  [then, thenAt] = [null, null];
  show();
  if (t === null) return;
  // A step takes less than a second to be decided and explained.
  const before = new Date((t + STEP_S) * 1e3).toISOString();
  const [answer, { found }] = await Promise.all([answerTo(`/corrections/${encodeURIComponent(machine)}?before=${encodeURIComponent(before)}`),
    fetchPast(t - STEP_S, t + STEP_S, "errors")]);
  const lines = answer.ok ? answer.told.lines : [];
  if (own !== asking) return;
  const last = Math.max(...lines.map((c) => c.k)), told = lines.filter((c) => c.k === last);
  const nearest = found?.t.length ? found.t.reduce((best, at, j) => (Math.abs(at - t) < Math.abs(found.t[best] - t) ? j : best), 0) : null;
  thenAt = told[0]?.t ?? null;
  then = told.length && nearest !== null ? errorsAt(Object.fromEntries(Object.entries(found.errors).map(([error, column]) => [error, column[nearest]])), told) : null;
  show();
};
export const readyWhy = () => {
  onMoment(follow);
  const sized = new ResizeObserver(fitLabels);
  for (const place of ["now-why", "why-axes", "moment-why"]) sized.observe($(place));
};

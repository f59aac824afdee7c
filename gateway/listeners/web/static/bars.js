// What is left at the tool as bars against the tolerance, and the verdict's hours back and ahead.
import { $, changed, make, piece, put } from "./elements.js";
import { amount, clock, word } from "./words.js";

// The scale, in tolerances to each side.
const REACH = 2.25;
const UM = { u: "", d: 1 };
const numbers = (axes) => axes.flatMap((a) => [a.far.n, Math.abs(a.without.n ?? 0)]).filter((n) => n !== null);

const bar = (axis, at, most, tolerance) => {
  const { left: { n: left }, half: { n: half }, without: { n: without }, colour } = axis, pieces = [];
  if (tolerance) pieces.push(piece("zone", at(-tolerance), at(tolerance)));
  pieces.push(piece("nought", 50));
  if (left !== null && half !== null) {
    const low = left - half, high = left + half, t = tolerance ?? Infinity;
    pieces.push(piece(colour === "red" ? "bar bad" : "bar", at(low), at(high)));
    if (colour === "amber" && low < -t) pieces.push(piece("bar warn", at(low), at(-t)));
    if (colour === "amber" && high > t) pieces.push(piece("bar warn", at(t), at(high)));
    if (without !== null) pieces.push(piece("moved", at(Math.min(without, left)), at(Math.max(without, left))));
    pieces.push(piece("tick", at(left)));
  }
  if (without !== null && Math.abs(without) > most) {
    const beyond = piece(without > 0 ? "beyond high" : "beyond low", without > 0 ? 100 : 0);
    beyond.append(make("i", undefined, "ring"), amount({ n: without, ...UM, sign: true }));
    pieces.push(beyond);
  } else if (without !== null) pieces.push(piece("ring", at(without)));
  return pieces;
};
const STANDING = { red: "bad", amber: "warn" };
const cell = (of, axis) => { const found = make("span", axis ? amount(axis[of]) : "–"); found.dataset.of = of; return found; };
export const showBars = (axes, tolerance) => {
  $("tool-empty").classList.toggle("spare", axes.length > 0);
  if (!changed("axes", [axes, tolerance])) return;
  const most = tolerance ? tolerance * REACH : Math.max(1, ...numbers(axes)) * 1.2;
  const at = (um) => 50 + 50 * Math.min(Math.max(um / most, -1), 1);
  for (const place of document.querySelectorAll("#axes article")) {
    const axis = axes.find((each) => each.axis === place.dataset.axis), track = place.querySelector(".track");
    track.replaceChildren(...(axis ? bar(axis, at, most, tolerance) : tolerance ? [piece("zone", at(-tolerance), at(tolerance))] : []));
    place.className = axis ? STANDING[axis.colour] ?? "" : "unknown";
    put(place.querySelector("[data-of=far]"), axis ? amount({ ...axis.far, u: "" }) : "–");
    place.querySelector("small").replaceChildren(cell("left", axis), " ± ", cell("half", axis));
  }
  for (const cell of document.querySelectorAll(".now-table [data-of]")) {
    const axis = axes.find((each) => each.axis === cell.closest("[data-axis]").dataset.axis);
    const taken = axis && { ...axis.without, n: axis.left.n === null ? null : axis.without.n - axis.left.n };
    put(cell, !axis ? "–" : cell.dataset.of === "interval" ? `${amount(axis.left)} ± ${amount(axis.half)}` : amount(cell.dataset.of === "taken" ? taken : axis.without));
  }
  put($("on-control"), axes.length ? word("tool.on_control").replace("{offsets}", axes.map((a) => `${a.axis} ${amount({ ...a.in_force, u: "" })}`).join(", ") + "\u202fµm") : "");
  const marks = tolerance ? [-tolerance, 0, tolerance] : [-most / 1.2, 0, most / 1.2];
  $("scale").replaceChildren(...marks.map((um) => {
    const mark = piece("", at(um));
    mark.textContent = amount({ n: um, d: um % 1 ? 1 : 0, sign: true });
    return mark;
  }));
};

const SPAN_S = 8 * 3600;
const WORDS = { green: "word.ready", amber: "word.unsure", red: "word.not_ready", grey: "word.unknown" };
// Runs of one colour: [colour, from, to]. What is farther apart than usual is not one run.
const runs = (t, state) => {
  const gaps = t.slice(1).map((end, i) => end - t[i]).sort((a, b) => a - b), longest = 3 * (gaps[gaps.length >> 1] ?? 0);
  const found = [];
  for (let i = 0; i + 1 < t.length; i++) {
    const last = found.at(-1), end = Math.min(t[i + 1], t[i] + longest);
    if (last && last[0] === state[i] && last[2] === t[i]) last[2] = end; else found.push([state[i], t[i], end]);
  }
  return found;
};
// present: the gateway's time, if what was foreseen still holds; else null
export const showStrip = (course, present) => {
  if (!course.t.length) return;
  const ahead = present !== null, now = Math.max(course.t.at(-1), ahead ? Math.floor(Date.parse(present) / 60e3) * 60 : 0);
  if (!changed("strip", [now, course.t, course.state, course.measured_t, ahead && [course.ahead_t, course.ahead_state]])) return;
  const at = (t) => 50 + 50 * (t - now) / SPAN_S, hour = (t) => clock.format(new Date(t * 1e3));
  const past = (course.state.length ? runs([...course.t, now], course.state) : []).filter(([, , to]) => to > now - SPAN_S);
  const coming = (ahead ? course.ahead_state : []).filter(([, , to]) => to > now).map(([colour, from, to]) => [colour, Math.max(from, now), to]);
  const label = (kind, t, text) => { const mark = piece(kind, at(t)); mark.textContent = text; return mark; };
  // Where the verdict begins or ends to be that the machine is ready.
  const turn = coming.find(([colour], i) => i && (colour === "green") !== (coming[i - 1][0] === "green"))?.[1], end = Math.min(at(coming.at(-1)?.[2] ?? now), 100);
  $("strip").replaceChildren(
    ...past.map(([colour, from, to]) => piece(at(to) - at(from) < 5 ? `run narrow ${colour}` : `run ${colour}`, Math.max(at(from), 0), at(to))),
    ...coming.map(([colour, from, to]) => piece(`run coming ${colour}`, at(from), Math.min(at(to), 100))),
    piece("run unforeseen", end, 100),
    ...course.measured_t.filter((t) => t > now - SPAN_S).map((t) => piece("dot", at(t))),
    piece("present", 50), label("hour first", now - SPAN_S, hour(now - SPAN_S)), label("hour now", now, hour(now)),
    ...(turn && at(turn) < 82 ? [piece("until", at(turn)), label("hour turn", turn, hour(turn))] : []), label("hour last", now + SPAN_S, hour(now + SPAN_S)));
  $("strip").setAttribute("aria-label", `${word("part.strip")}: ` + [...past, ...coming]
    .map(([colour, from, to]) => `${word(WORDS[colour])} ${hour(from)}\u2013${hour(to)}`).join(", "));
};

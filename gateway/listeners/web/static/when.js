// The next two hours: the largest error left, as it is and under loads; and what a load would do that somebody thinks of.
import { machine, query } from "./choice.js";
import { $, changed, drawn, make, put, say } from "./elements.js";
import { amount, answerTo, atom, clock, time, word } from "./words.js";

let latest = null, asked = null, tolerance = null;
const PAPER = matchMedia("print"), WIDE = matchMedia("(min-width: 1200px) and (min-height: 640px)"), NARROW = matchMedia("(max-width: 760px)");
const HOURS = 2, PAD = [40, 10, 12, 24], WORDS = 110;
const numbers = (list) => list.filter((n) => n !== null);
const STYLES = ["b0", "b1", "b2", "b3"];
// branches: as the server tells them; the last one may be what somebody has asked for
const picture = (branches, width, height) => {
  const [left, right, top, bottom] = PAD, most = 1.15 * Math.max(tolerance ?? 0, ...branches.flatMap((b) => numbers(b.high)), 1);
  const x = (s) => left + (width - left - right) * s / (HOURS * 3600), y = (um) => height - bottom - (height - top - bottom) * Math.min(um, most) / most;
  const path = (points) => points.length ? "M" + points.map(([s, um]) => `${x(s).toFixed(1)} ${y(um).toFixed(1)}`).join("L") : "";
  const found = [], size = most > 40 ? 20 : most > 16 ? 8 : most > 8 ? 4 : 2;
  if (tolerance) found.push(drawn("rect", { class: "inside-zone", x: left, y: y(tolerance), width: width - left - right, height: height - bottom - y(tolerance) }));
  for (let um = 0; um < most; um += size) found.push(drawn("path", { class: "grid", d: `M${left} ${y(um)}H${width - right}` }), drawn("text", { class: "end", x: left - 5, y: y(um) + 4 }, amount({ n: um, d: 0 })));
  if (tolerance) found.push(drawn("path", { class: "limit", d: `M${left} ${y(tolerance)}H${width - right}` }));
  // Beyond what has been checked, nothing is claimed.
  const checked = Math.max(...branches.flatMap((b) => b.t.filter((_, j) => b.high[j] !== null)));
  if (checked < HOURS * 3600) {
    found.push(drawn("rect", { class: "unforeseen", x: x(checked), y: top, width: width - right - x(checked), height: height - top - bottom }));
    if (width - right - x(checked) > 150) found.push(drawn("text", { class: "mid", x: (x(checked) + width - right) / 2, y: height - bottom - 12 }, word("scenario.unforeseen")));
  }
  const began = branches[0].began * 1e3;
  let turned = 0;
  branches.forEach((b, i) => {
    const kind = b.load === "?" ? "asked" : STYLES[Math.min(i, STYLES.length - 1)], known = b.t.flatMap((s, j) => b.high[j] !== null ? [j] : []);
    found.push(drawn("path", { class: `line ${kind}`, d: path(known.map((j) => [b.t[j], b.high[j]])) }));
    if (tolerance && b.turn !== null && b.turn <= HOURS * 3600) {
      // The words lie where the curve does not: above the limit before it rises over it or after it has fallen, a second one below on the other side.
      const rises = b.high[0] <= tolerance, best = rises === (turned === 0), room = (before) => WORDS < (before ? x(b.turn) - left : width - right - x(b.turn)), before = room(best) ? best : !best;
      found.push(drawn("circle", { class: "ready", cx: x(b.turn), cy: y(tolerance), r: 5 }), drawn("text", { class: before ? "turn end" : "turn", x: x(b.turn) + (before ? -8 : 8), y: y(tolerance) + (turned ? 18 : -7) },
        word(rises ? "until.at" : "until.ready").replace("{at}", clock.format(began + b.turn * 1e3))));
      turned += 1;
    }
  });
  for (let s = 0; s <= HOURS * 3600; s += 1800) if (s % 3600 === 0 || width > 440) found.push(drawn("text", { class: s ? s === HOURS * 3600 ? "end" : "mid" : "", x: x(s), y: height - 6 }, clock.format(began + s * 1e3)));
  return found;
};
const nameOf = (b) => b.load === "?" ? asked.name : b.load || word("scenario.as_now");
const show = () => {
  if (!latest) return;
  // A planned load is foreseen as long as the picture is: what else the form says, somebody has to ask for.
  const whole = Number($("warm-minutes").value) === 60 * HOURS;
  const place = $("warm"), own = (latest.alive ? latest.branches : []).filter((b) => b.load === "" || whole && b.load === $("warm-load").value);
  const branches = asked?.branches.length ? asked.branches : own, { clientWidth: width, clientHeight: height } = place;
  $("warm-empty").classList.toggle("spare", branches.length > 0);
  if (!width || !changed("warm", [branches, tolerance, width, height, time(latest.gateway_time)])) return;
  place.setAttribute("viewBox", `0 0 ${width} ${height}`);
  place.replaceChildren(...(branches.length ? picture(branches, width, height) : []));
  $("warm-names").replaceChildren(...branches.map((b, i) => {
    const item = make("span", nameOf(b), "branch"), mark = make("i", undefined, b.load === "?" ? "asked" : STYLES[Math.min(i, STYLES.length - 1)]);
    item.prepend(mark);
    return item;
  }));
};
const offer = (planned) => {
  if (!changed("warm-load", planned)) return;
  const chosen = $("warm-load").value;
  $("warm-load").replaceChildren(...[...planned.map((name) => [name, name]), ["", word("scenario.spindle")]].map(([value, text]) => Object.assign(make("option", text), { value })));
  if (planned.includes(chosen)) $("warm-load").value = chosen;
};
export const drawWhen = () => show();
// v: what the page shows
export const showWhen = (v) => {
  latest = v;
  tolerance = v.tolerance_um;
  if (!v.alive) { asked = null; $("warm-said").replaceChildren(); }
  $("warm-ask").disabled = !v.alive;
  put($("warm-empty"), word(v.alive ? "scenario.nothing" : "scenario.no_forecast"));
  offer(v.planned ?? []);
  show();
};
const ask = async () => {
  const minutes = Number($("warm-minutes").value), name = $("warm-load").selectedOptions[0].textContent, parameters = new URLSearchParams({ load: $("warm-load").value, minutes: String(minutes) });
  if (!$("warm-minutes").reportValidity()) return;
  $("warm-ask").disabled = true;
  const { ok, told } = await answerTo(`/scenario/${encodeURIComponent(machine)}?${parameters}&${query()}`);
  $("warm-ask").disabled = false;
  if (ok) {
    asked = { ...told, name };
    $("warm-said").replaceChildren(...say(asked.said));
  } else {
    asked = null;
    put($("warm-said"), atom(told));
  }
  show();
};
// A desktop and a phone have it on the first screen; a panel beside what moves the errors. What begins to be printed has
// been divided into pages already.
const settle = () => PAPER.matches || (WIDE.matches || NARROW.matches ? $("now") : $("why-right")).append($("when"));
export const readyWhen = () => {
  $("warm-ask").addEventListener("click", ask);
  for (const each of ["warm-load", "warm-minutes"]) $(each).addEventListener("change", () => { asked = null; $("warm-said").replaceChildren(); show(); });
  for (const each of [WIDE, NARROW]) each.addEventListener("change", settle);
  settle();
  new ResizeObserver(show).observe($("warm"));
};

// The state of one machine, on all of its screens.
import { showBars } from "./bars.js";
import { keepTolerance, showSeries } from "./chart.js";
import { keepSphere, machine, point, sphere } from "./choice.js";
import { showDay as showLastDay } from "./day.js";
import { $, changed, draw, make, paint, put, rows, say } from "./elements.js";
import { showModel } from "./model.js";
import { hear, stateUnit } from "./past.js";
import { lead } from "./screens.js";
import { showSensors } from "./sensors.js";
import { amount, exact, lasted, recent, sentence, setToday, weekday, whole, word } from "./words.js";
import { openProblems } from "./tables.js";
import { showWhen } from "./when.js";
import { eachMoved, mostMoved, showWhy } from "./why.js";

// The day is the gateway's present one in this browser's zone, until somebody chooses another.
let chosenDay = false;
const showDay = (v) => {
  const now = new Date(v.gateway_time || Date.now()), two = (n) => String(n).padStart(2, "0");
  if (!chosenDay && document.activeElement !== $("report-day")) {
    const today = `${now.getFullYear()}-${two(now.getMonth() + 1)}-${two(now.getDate())}`;
    if ($("report-day").value !== today) $("report-day").value = today;
  }
  const chosen = $("report-day").value, zone = new Intl.DateTimeFormat().resolvedOptions().timeZone || "";
  const there = chosen ? `/machine/${encodeURIComponent(machine)}/report/${chosen}?zone=${encodeURIComponent(zone)}&lang=${document.documentElement.lang}${v.tolerance_um ? `&tolerance=${v.tolerance_um}` : ""}` : null;
  if (there === null) $("report").removeAttribute("href"); else if ($("report").getAttribute("href") !== there) $("report").setAttribute("href", there);
};

// What has no room is on a next page beside the first; the wheel turns these, too.
export const readyNext = () => {
  const box = document.querySelector(".inside");
  box.addEventListener("wheel", (event) => {
    if (box.scrollWidth <= box.clientWidth || event.deltaX) return;
    event.preventDefault();
    box.scrollBy({ left: Math.sign(event.deltaY) * box.clientWidth });
  }, { passive: false });
};
// latest: what the page shows
export const readyDay = (latest) => $("report-day").addEventListener("change", () => {
  chosenDay = $("report-day").value !== "";
  showDay(latest() || {});
});

// A reason of more letters than this is written smaller.
const LONG = 85, LONG_WORD = 12;
// Of what it waits for, what somebody does or waits for next.
const NEXT = ["label.unarmed", "label.first", "label.waits_for", "label.operator", "label.next"];
const ORDERS = ["because.paused", "because.disarmed"];
// What it costs to wait for the next measurement.
const PRICE = ["label.waiting"];
// When it will be ready, and what helps most: to be read from two metres.
const AFAR = /^(when\.(?!next_measurement)|help\.(best|nothing|measure))/;
const orders = (notices) => {
  const found = make("div");
  found.id = "notices";
  found.append(...say(notices, "notice"));
  return found;
};
const list = (rows) => {
  const found = make("dl");
  found.append(...rows.flatMap((row) => [make("dt", word(row.label)), make("dd", sentence(row.said))]));
  return found;
};
// What the sentence on the next hours says, beside the verdict.
const UNTIL = { "when.until": "until.at", "when.stays": "until.least", "when.ready": "until.ready", "when.measured": "until.measured" };
// tolerance: that it is judged by, µm; wrong: what is wrong, beside it
export const showWord = ({ colour, word: key, since, before, helps }, tolerance = null, wrong = "") => {
  const found = helps.find((help) => help.say in UNTIL), until = found ? sentence({ ...found, say: UNTIL[found.say] }) : "";
  const when = since ? word(before ? "since.before" : "since.at").replace("{at}", () => recent(since)).replace("{for}", () => lasted(since)) : "";
  paint($("ready"), colour);
  put($("word"), word(key));
  paint($("badge"), colour);
  const judged = tolerance && (colour === "green" || colour === "amber" || colour === "red") ? `±\u00a0${amount({ n: tolerance, u: "µm", d: tolerance % 1 ? 1 : 0 })}` : "";
  if (changed("badge", [key, judged, when, until, wrong])) $("badge").firstChild.replaceChildren(
    // What is roomy, a phone has no room for.
    ...[[word(key)], judged && [judged, "roomy"], until && when && [when, "roomy"], (until || when) && [until || when], wrong && [wrong, "roomy"]].filter(Boolean).map(([text, kind], i) => make("span", (i ? " · " : "") + text, kind)));
  put($("since"), when);
  put($("until"), until);
  $("ready").dataset.word = key;
  $("word").classList.toggle("long", word(key).length > LONG_WORD);
  document.title = `${word(key)} · ${machine}`;
};

export const showMachine = (v) => {
  const { verdict } = v, simulated = v.simulated && v.gateway_time ? new Date(v.gateway_time) : null;
  setToday(simulated);
  document.body.classList.toggle("past", !v.alive);
  const open = openProblems(), order = verdict.because.find((each) => ORDERS.includes(each.say));
  const wrong = verdict.failed ? sentence(verdict.failed) : v.alive && open ? word("events.open").replace("{n}", open) : "";
  showWord(verdict, v.tolerance_um, wrong || (order ? sentence(order) : ""));
  $("failed").classList.toggle("none", !wrong);
  put($("failed"), wrong || (v.alive && verdict.colour === "green" ? word(v.notices.length || v.unarmed ? "events.switched_off" : "events.nothing") : ""));
  const heard = v.heard ? [make("span", word("page.heard").replace("{at}", exact.format(new Date(v.heard))))] : [];
  if (!v.alive && !simulated && v.heard) heard.push(make("span", " · " + word("page.ago").replace("{for}", lasted(v.heard))));
  if (simulated) heard.unshift(make("b", word("page.simulated").replace("{at}", weekday.format(simulated))));
  draw("heard", [heard.map((each) => each.textContent)], () => heard);
  if (v.gateway_time) put($("state-of"), word("print.state_of").replace("{at}", whole.format(new Date(v.gateway_time))));
  $("unarmed").classList.toggle("spare", !v.unarmed);
  if (changed("because", verdict.because)) {
    $("because").replaceChildren(...say(verdict.because.filter((each) => !each.say.startsWith("do."))));
    $("because").classList.toggle("long", $("because").textContent.length > LONG);
  }
  showWhy(v);
  const most = v.alive ? mostMoved(v.tolerance_um) : null;
  const next = v.alive ? v.waits.filter((row) => NEXT.includes(row.label)) : [];
  draw("todo", verdict.because, () => verdict.because.filter((each) => each.say.startsWith("do.")).map((each, i) => make("p", sentence(each), i ? "" : "afar")));
  const look = verdict.failed?.values.first ? [{ ...verdict.failed, say: "do.look" }] : [];
  const moved = v.alive ? eachMoved(v.tolerance_um) : "";
  for (const place of document.querySelectorAll(".each-moved")) put(place, moved);
  draw("helps", [v.notices, look, verdict.helps, next, most], () => {
    const said = (far) => verdict.helps.filter((help) => AFAR.test(help.say) === far).map((help) => make("p", sentence(help), far ? "afar" : undefined));
    return [orders([...v.notices, ...look]), ...said(true), ...(most ? [make("p", most, "from-where")] : []), list(next), ...said(false)];
  });
  showBars(v.axes, v.tolerance_um);
  if (v.axes.length) lead(v.axes.reduce((a, b) => (b.far.n > a.far.n ? b : a)).axis);
  keepTolerance(v.tolerance_um);
  keepSphere(v.sphere_mm);
  showModel(v, sphere(), point().slice(3), v.alive);
  const inputs = [...v.channels, ...Object.entries(v.inputs).map(([channel, n]) => ({ channel, good: n !== null, value: n === null ? null : { n, u: stateUnit(channel) } }))];
  if (v.alive && v.gateway_time) hear(inputs, Date.parse(v.gateway_time) / 1e3);
  showSeries(inputs);
  showLastDay(v);
  draw("tool-notes", v.tool_notes, () => say(v.tool_notes, "note"));
  showWhen(v);
  const price = v.alive ? v.waits.filter((row) => PRICE.includes(row.label)) : [];
  draw("price", price, () => rows(price));
  const waits = v.waits.filter((row) => !PRICE.includes(row.label));
  draw("waits", waits, () => rows(waits));
  draw("health", v.health, () => rows(v.health));
  showSensors(v);
  showDay(v);
};

// Shows what the server sends, one machine or the list of all.
import { showStrip } from "./bars.js";
import { forgetCourse, keepForecast, readyChart, showCourse, showMarks, showScreen } from "./chart.js";
import { machine, query, queryOfAll, readyChoice } from "./choice.js";
import { takeCourse, takeDay } from "./day.js";
import { hideCommands, readyCommands, showCommands } from "./commands.js";
import { $, afterPaint, changed, make, put, say } from "./elements.js";
import { readyDay, readyNext, showMachine, showWord } from "./machine.js";
import { readyScreens, watch } from "./screens.js";
import { showSensitivity } from "./sensitivity.js";
import { showBody } from "./sensors.js";
import { stream } from "./stream.js";
import { readyTables, showWeeks, takeCorrections, takeEvents } from "./tables.js";
import { drawWhen, readyWhen } from "./when.js";
import { readyWhy, showAxis, takeMoved } from "./why.js";
import { amount, present, sentence, setPresent, time, word } from "./words.js";

let latest = null, course = null, state = "heard", showAgain = () => {};
// Until all of it is there, nothing of it: what came piece by piece would push the rest about.
const showAll = () => document.body.classList.remove("waiting");
const UNKNOWN = { alive: false, unarmed: false, notices: [] };
const NOTHING = { axes: [], errors: {}, tool_notes: [] };
const NAME = document.title;
const strip = () => { if (course) showStrip(course, state === "heard" && latest?.alive && latest.gateway_time ? latest.gateway_time : null); };
// now: "heard"; "lost", when the server does not answer; "full", when it takes no more than `most` browsers; "resting",
// while nobody sees this tab and it does not listen.
const become = (now, most) => {
  if (now === state) return;
  state = now;
  const full = now === "full", lost = now === "lost" || full;
  const key = full ? "word.full" : lost ? "word.lost" : "word.connecting";
  document.body.classList.toggle("past", now !== "heard" || (latest !== null && latest.alive === false));
  $("lost").hidden = !lost;
  keepForecast(now === "heard");
  strip();
  if (now === "heard") { showAgain(); return; }  // the server sends nothing again that has not changed
  const since = full ? { say: "page.full", values: { n: { n: most, d: 0 } } }
    : latest ? { say: "page.no_server", values: { at: { t: latest.shownAt } } } : { say: "page.unreached", values: {} };
  const verdict = { colour: lost ? "away" : "grey", word: key, because: lost ? [since] : [], since: null, helps: [] };
  hideCommands();
  if (lost) {
    showAll();
    $("lost").textContent = sentence(since);
  }
  if (!machine) drawList((latest ? latest.list : []).map((each) => ({ ...each, ...UNKNOWN, ...verdict })));
  else if (latest) showMachine({ ...latest, ...UNKNOWN, verdict, ...NOTHING });
  else if (lost) showWord(verdict);
  if (!lost) document.title = machine || NAME;
};

// The clock of a page that gets no more messages.
const AGAIN_MS = 10e3;
let soon;
const again = () => { if (state === "heard") showAgain(); soon = setTimeout(again, AGAIN_MS); };
const showView = (v) => {
  clearTimeout(soon);
  latest = { ...v, shownAt: present().toISOString() };
  showAgain = () => { showMachine(v); showCommands(v); strip(); };
  if (!v.alive) soon = setTimeout(again, AGAIN_MS);
  showAgain();
};

// What has not changed stays in place, and what has the keyboard keeps it.
const items = new Map();
const item = (m, language) => {
  const text = JSON.stringify(m), known = items.get(m.machine);
  if (known && known.text === text) return known.node;
  const node = make("li", undefined, m.colour), link = make("a");
  link.href = `/machine/${encodeURIComponent(m.machine)}?lang=${language}`;
  link.append(make("span", undefined, "sign"), make("span", m.machine, "name"), " ", make("span", word(m.word), "word"));
  link.firstChild.setAttribute("aria-hidden", "true");
  node.append(link, ...say(m.notices, "notice"), ...say(m.because),
    make("p", m.heard ? word("page.heard").replace("{at}", time(m.heard)) : "", "note"));
  items.set(m.machine, { text, node, link });
  return node;
};
const drawList = (list) => {
  $("no-machine").hidden = list.length > 0;
  if (!changed("machines", list)) return;
  const focused = [...items.entries()].find(([, each]) => each.link === document.activeElement);
  const nodes = list.map((m) => item(m, document.documentElement.lang)), place = $("machines");
  if (nodes.length !== place.children.length || nodes.some((node, i) => node !== place.children[i])) place.replaceChildren(...nodes);
  if (focused && items.has(focused[0])) items.get(focused[0]).link.focus({ preventScroll: true });
  const counts = new Map();
  for (const m of list) counts.set(m.word, (counts.get(m.word) || 0) + 1);
  put($("summary"), list.length > 1 ? [...counts].map(([key, n]) => `${word(key)}: ${amount({ n, d: 0 })}`).join(" · ") : "");
};
const showList = (list) => {
  latest = { alive: true, list, shownAt: present().toISOString() };
  showAgain = () => drawList(list);
  showAgain();
};

// ms: the server's present. A screen whose own clock is wrong says so: people compare its times with the clock on it.
const CLOCK_OFF_MS = 120e3;
const takeClock = (ms) => {
  const off = setPresent(ms), minutes = Math.abs(off) / 60e3, long = minutes >= 60;
  $("clock-off").hidden = Math.abs(off) < CLOCK_OFF_MS;
  put($("clock-off"), word(off > 0 ? "page.clock_slow" : "page.clock_fast")
    .replace("{off}", amount(long ? { n: minutes / 60, u: "h", d: 1 } : { n: minutes, u: "min", d: 0 })));
};
if (machine) {
  readyCommands();
  readyChoice(() => { forgetCourse(); listen(); });
  readyTables();
  readyDay(() => latest);
  readyNext();
  readyChart();
  readyWhy();
  readyWhen();
  readyScreens();
  [showScreen, showBody, showAxis, drawWhen].forEach(watch);
}
const asked = () => machine ? query() : queryOfAll();
const address = () => (machine ? `/stream/${encodeURIComponent(machine)}?` : "/stream?") + asked();
// The state in the page was judged by what is declared: it does not fit a browser that asks for something else.
const early = () => asked() || !$("first") ? null : JSON.parse($("first").textContent);
const listen = stream(address, {
  tick: takeClock,
  list: (list) => { showAll(); showList(list); },
  view: showView,
  events: (list) => { takeEvents(list); showMarks(list); showAgain(); },
  corrections: (list) => { takeCorrections(list); takeDay(list); },
  course: (c) => {
    course = c;
    showAll();
    strip();
    showCourse(c);
    takeCourse(c);
    takeMoved(c);
  },
}, become, early());
if (machine) {
  const answers = () => state === "heard" && latest && latest.alive && latest.gateway_time;
  afterPaint(() => { showWeeks(answers); showSensitivity(answers); });
}

// Shows what the server sends, one machine or the list of all.
import { forgetCourse, keepForecast, readyCharts, showCourse } from "./charts.js";
import { machine, query, readyChoice } from "./choice.js";
import { hideCommands, readyCommands, showCommands } from "./commands.js";
import { $, draw, keepHeights, make, paint, put, rows, say } from "./elements.js";
import { readyDay, showMachine } from "./machine.js";
import { reserve, WAITS } from "./room.js";
import { showSensitivity } from "./sensitivity.js";
import { readyTables, showWeeks, takeCorrections, takeEvents } from "./tables.js";
import { sentence, time, word } from "./words.js";

const SILENT_MS = 7000;
let latest = null, heardMs = performance.now(), lost = false, showAgain = () => {};
// Until all of it is there, nothing of it: what came piece by piece would push the rest about.
const showAll = () => document.body.classList.remove("waiting");
const UNKNOWN = { alive: false, unarmed: false, notices: [] };
const loseOrFind = (gone) => {
  if (gone === lost) return;
  lost = gone;
  document.body.classList.toggle("past", lost || (latest !== null && latest.alive === false));
  $("lost").hidden = !lost;
  keepForecast(!lost);
  if (!lost) showAgain();  // the server sends nothing again that has not changed
  else {
    const since = { say: "page.no_server", values: { at: { t: latest ? latest.shownAt : "" } } };
    const verdict = { colour: "grey", word: "word.lost", because: [since], since: null, helps: [] };
    showAll();
    hideCommands();
    $("lost").textContent = sentence(since);
    if (!machine) drawList((latest ? latest.list : []).map((each) => ({ ...each, ...UNKNOWN, ...verdict })));
    else if (latest) showMachine({ ...latest, ...UNKNOWN, verdict, axes: [] });
    else {
      paint($("ready"), "grey");
      put($("word"), word("word.lost"));
      document.title = `${word("word.lost")} · ${machine}`;
    }
  }
};

const showView = (v) => {
  latest = { ...v, shownAt: new Date().toISOString() };
  showAgain = () => { showMachine(v); showCommands(v); };
  showAgain();
};

const drawList = (list) => {
  $("no-machine").hidden = list.length > 0;
  const language = document.documentElement.lang;
  draw("machines", list, () => list.map((m) => {
    const item = make("li", undefined, m.colour), link = make("a");
    link.href = `/machine/${encodeURIComponent(m.machine)}?lang=${language}`;
    link.append(make("span", undefined, "sign"), make("span", m.machine, "name"), " ", make("span", word(m.word), "word"));
    link.firstChild.setAttribute("aria-hidden", "true");
    item.append(link, ...say(m.notices, "notice"), ...say(m.because),
      make("p", m.heard ? word("page.heard").replace("{at}", time(m.heard)) : "", "note"));
    return item;
  }));
};
const showList = (list) => {
  latest = { alive: true, list, shownAt: new Date().toISOString() };
  showAgain = () => drawList(list);
  showAgain();
};

let stream = null;
const listen = () => {
  if (stream) stream.close();
  stream = new EventSource((machine ? "/stream/" + encodeURIComponent(machine) : "/stream") + "?" + (machine ? query() : ""));
  const on = (kind, show) => stream.addEventListener(kind, (event) => {
    heardMs = performance.now();
    loseOrFind(false);
    if (show) show(JSON.parse(event.data));
  });
  on("tick");
  on("list", (list) => { showAll(); showList(list); });
  on("view", showView);
  on("events", takeEvents);
  on("corrections", takeCorrections);
  on("course", (course) => { showAll(); showCourse(course); });
  stream.onerror = () => {
    loseOrFind(true);
    if (stream.readyState === EventSource.CLOSED) setTimeout(listen, 3000);
  };
};
setInterval(() => { if (performance.now() - heardMs > SILENT_MS) loseOrFind(true); }, 1000);

if (machine) {
  reserve(document);
  $("waits-room").replaceChildren(...rows(WAITS));
  readyCommands();
  readyChoice(() => { forgetCourse(); listen(); });
  readyTables();
  readyDay(() => latest);
  readyCharts();
  keepHeights(document.querySelectorAll(".kept"));
  const answers = () => !lost && latest && latest.alive && latest.gateway_time;
  showWeeks(answers);
  showSensitivity(answers);
}
listen();

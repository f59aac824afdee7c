// The state of one machine: whether it is ready, the tool, what it waits for, heat, health.
import { machine } from "./choice.js";
import { $, changed, draw, make, marked, named, paint, put, rows, say } from "./elements.js";
import { HEALTH, LONG, QUALITY, reservePlanned } from "./room.js";
import { amount, exact, sentence, time, whole, word } from "./words.js";

const showAxes = (axes) => {
  $("tool-empty").classList.toggle("spare", axes.length > 0);
  for (const place of document.querySelectorAll("#axes article")) {
    const axis = axes.find((each) => each.axis === place.dataset.axis);
    for (const cell of place.querySelectorAll("[data-of]")) put(cell, axis ? amount(axis[cell.dataset.of]) : "–");
  }
};

const doubt = (said) => { const p = make("p", sentence(said), "doubt"); p.prepend(marked("bad"), " "); return p; };
const line = (c) => {
  const item = make("li", undefined, c.good ? "" : "not-good");
  item.append(make("span", c.channel, "name"), " ");
  if (c.good || c.value) item.append(make("span", c.value ? amount(c.value) : "–", "number"));
  if (!c.good) item.append(" ", make("span", word(c.quality), "mark m-bad"));
  if (c.detail) item.title = sentence(c.detail);
  return item;
};
// Those that fail come first and need more room: as much as SPARE of them need with the longest name and fault.
const SPARE = 4, MOST_NAMED = 4;
const reserveHeat = (channels) => {
  const names = channels.map((c) => c.channel).sort();
  if (!names.length || !changed("heat-room", names)) return;
  const longestName = names.reduce((a, b) => (b.length > a.length ? b : a));
  const failed = { channel: longestName, good: false, value: null, quality: QUALITY, detail: null };
  $("channels-room").replaceChildren(...channels.map((c, i) => line(i < SPARE ? failed : { ...c, good: true })));
  $("doubts-room").replaceChildren(doubt({ say: "doubt.failed", values: { names: { s: longestName } } }));
};

// As long as what moves an error may be told: by the inputs with the longest names.
const longMovers = (channels) => channels.map((c) => c.channel).sort((a, b) => b.length - a.length || (a < b ? -1 : 1))
  .slice(0, MOST_NAMED).map((input) => `${input} ${amount(LONG.gain)}`).join(", ");

const showHeat = (v) => {
  draw("doubts", v.doubts, () => v.doubts.length ? v.doubts.map(doubt)
    : v.channels.length ? [make("p", word("doubt.none"), "note")] : []);
  reserveHeat(v.channels);
  put($("watched"), v.watched ? sentence(v.watched) : "");
  $("heat-empty").hidden = v.channels.length > 0;
  draw("channels", v.channels, () => v.channels.map(line));
  showSketch(v.channels.filter((c) => c.body));
  $("drives-empty").hidden = v.driven.length > 0;
  $("drives").hidden = !v.driven.length;
  const most = longMovers(v.channels);
  if (!changed("drives", [v.driven, most])) return;
  $("drives").tBodies[0].replaceChildren(...v.driven.map((e) => {
    const row = make("tr"), name = named(e.error, "th");
    name.scope = "row";
    const by = e.corrected ? e.movers.map(([input, by]) => `${input} ${amount(by)}`).join(", ") : word("heat.not_corrected");
    const cell = make("td"), room = make("div", undefined, "room");
    room.append(make("div", by), make("div", most, "spare"));
    cell.append(room);
    row.append(name, make("td", amount(e.estimate), "right"), cell);
    return row;
  }));
};

// The mean of each part; nothing where no name tells of one.
const showSketch = (channels) => {
  const sketch = $("sketch");
  sketch.toggleAttribute("hidden", !channels.length);
  for (const part of sketch.querySelectorAll("[data-body]")) {
    const own = channels.filter((c) => c.body === part.dataset.body && (!c.value || c.value.u === "°C"));
    const good = own.filter((c) => c.good && c.value);
    const mean = good.length ? good.reduce((sum, c) => sum + c.value.n, 0) / good.length : null;
    put(part.querySelector(".number"), amount({ n: mean, u: "°C", d: 1 }) + (good.length < own.length ? " !" : ""));
    part.classList.toggle("doubtful", good.length < own.length);
    part.classList.toggle("nothing", !own.length);
  }
};

// The day is the gateway's present one in this browser's zone, until somebody chooses another.
let chosenDay = false;
const showDay = (v) => {
  const now = new Date(v.gateway_time || Date.now()), two = (n) => String(n).padStart(2, "0");
  if (!chosenDay && document.activeElement !== $("report-day")) {
    const today = `${now.getFullYear()}-${two(now.getMonth() + 1)}-${two(now.getDate())}`;
    if ($("report-day").value !== today) $("report-day").value = today;
  }
  const chosen = $("report-day").value, zone = new Intl.DateTimeFormat().resolvedOptions().timeZone || "";
  const there = chosen ? `/machine/${encodeURIComponent(machine)}/report/${chosen}?zone=${encodeURIComponent(zone)}&lang=${document.documentElement.lang}` : null;
  if (there === null) $("report").removeAttribute("href"); else if ($("report").getAttribute("href") !== there) $("report").setAttribute("href", there);
};

// latest: what the page shows
export const readyDay = (latest) => $("report-day").addEventListener("change", () => {
  chosenDay = $("report-day").value !== "";
  showDay(latest() || {});
});

// When it will be ready, and what helps most: to be read from two metres.
const AFAR = /^(when\.(?!next_measurement)|help\.(best|nothing|measure))/;
export const showWord = (colour, key) => {
  paint($("ready"), colour);
  put($("word"), word(key));
  document.title = `${word(key)} · ${machine}`;
};

export const showMachine = (v) => {
  const { verdict } = v;
  document.body.classList.toggle("past", !v.alive);
  showWord(verdict.colour, verdict.word);
  const heard = [];
  if (v.heard) heard.push(word("page.heard").replace("{at}", exact.format(new Date(v.heard))));
  if (v.simulated && v.gateway_time) heard.push(word("page.simulated").replace("{at}", time(v.gateway_time)));
  put($("heard"), heard.join(" · "));
  if (v.gateway_time) put($("state-of"), word("print.state_of").replace("{at}", whole.format(new Date(v.gateway_time))));
  $("unarmed").classList.toggle("spare", !v.unarmed);
  draw("because", verdict.because, () => say(verdict.because));
  put($("since"), verdict.since ? word(verdict.before ? "since.before" : "since.at").replace("{at}", time(verdict.since)) : "");
  if (changed("helps", [v.notices, verdict.helps])) {
    $("notices").replaceChildren(...say(v.notices, "notice"));
    $("helps").replaceChildren(...verdict.helps.map((help) => make("p", sentence(help), AFAR.test(help.say) ? "afar" : undefined)));
  }
  reservePlanned(v.planned);
  showAxes(v.axes);
  draw("tool-notes", v.tool_notes, () => say(v.tool_notes, "note"));
  draw("waits", v.waits, () => rows(v.waits));
  draw("health", v.health, () => rows(v.health, HEALTH));
  showHeat(v);
  showDay(v);
};

// The state of one machine: whether it is ready, the tool, what it waits for, heat, health.
import { machine } from "./choice.js";
import { $, changed, draw, make, marked, paint, put, rows, say } from "./elements.js";
import { reservePlanned } from "./room.js";
import { amount, exact, sentence, time, whole, word } from "./words.js";

const showAxes = (axes) => {
  $("tool-empty").classList.toggle("spare", axes.length > 0);
  for (const place of document.querySelectorAll("#axes article")) {
    const axis = axes.find((each) => each.axis === place.dataset.axis);
    for (const cell of place.querySelectorAll("[data-of]")) put(cell, axis ? amount(axis[cell.dataset.of]) : "–");
  }
};

const showHeat = (v) => {
  draw("doubts", v.doubts, () => v.doubts.length
    ? v.doubts.map((each) => { const p = make("p", sentence(each), "doubt"); p.prepend(marked("bad"), " "); return p; })
    : v.channels.length ? [make("p", word("doubt.none"), "note")] : []);
  put($("watched"), v.watched ? sentence(v.watched) : "");
  $("heat-empty").hidden = v.channels.length > 0;
  draw("channels", v.channels, () => v.channels.map((c) => {
    const item = make("li", undefined, c.good ? "" : "not-good");
    item.append(make("span", c.channel, "name"), " ", make("span", c.value ? amount(c.value) : "–", "number"));
    if (!c.good) item.append(" ", make("span", word(c.quality), "mark m-bad"));
    if (c.detail) item.title = c.detail;
    return item;
  }));
  showSketch(v.channels.filter((c) => c.body));
  $("drives-empty").hidden = v.driven.length > 0;
  $("drives").hidden = !v.driven.length;
  if (!changed("drives", v.driven)) return;
  $("drives").tBodies[0].replaceChildren(...v.driven.map((e) => {
    const row = make("tr"), name = make("th", e.error);
    name.scope = "row";
    const by = e.corrected ? e.movers.map(([input, by]) => `${input} ${amount(by)}`).join(", ") : word("heat.not_corrected");
    row.append(name, make("td", amount(e.estimate), "right"), make("td", by));
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
  const there = chosen ? `/machine/${encodeURIComponent(machine)}/report/${chosen}?zone=${encodeURIComponent(zone)}` : null;
  if (there === null) $("report").removeAttribute("href"); else if ($("report").getAttribute("href") !== there) $("report").setAttribute("href", there);
};

// latest: what the page shows
export const readyDay = (latest) => $("report-day").addEventListener("change", () => {
  chosenDay = $("report-day").value !== "";
  showDay(latest() || {});
});

export const showMachine = (v) => {
  const { verdict } = v;
  document.body.classList.toggle("past", !v.alive);
  paint($("ready"), verdict.colour);
  put($("word"), word(verdict.word));
  document.title = `${word(verdict.word)} · ${v.machine}`;
  const heard = [];
  if (v.heard) heard.push(word("page.heard").replace("{at}", exact.format(new Date(v.heard))));
  if (v.simulated && v.gateway_time) heard.push(word("page.simulated").replace("{at}", time(v.gateway_time)));
  put($("heard"), heard.join(" · "));
  if (v.gateway_time) put($("state-of"), word("print.state_of").replace("{at}", whole.format(new Date(v.gateway_time))));
  draw("notices", v.notices, () => say(v.notices, "notice"));
  draw("because", verdict.because, () => say(verdict.because));
  put($("since"), verdict.since ? word("since.at").replace("{at}", time(verdict.since)) : "");
  draw("helps", verdict.helps, () => say(verdict.helps));
  reservePlanned(v.planned);
  showAxes(v.axes);
  draw("tool-notes", v.tool_notes, () => say(v.tool_notes, "note"));
  draw("waits", v.waits, () => rows(v.waits));
  draw("health", v.health, () => rows(v.health));
  showHeat(v);
  showDay(v);
};

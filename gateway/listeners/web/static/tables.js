// What has happened, as tables: events, corrections, and how far measurements scatter.
import { machine } from "./choice.js";
import { $, make, named, put } from "./elements.js";
import { amount, answerTo, atom, date, sentence, time, word } from "./words.js";

// On paper only the latest, and a line that says how many are not printed.
const EVENTS_PRINTED = 20, CORRECTIONS_PRINTED = 10;
const keepOffPaper = (rows, most, note) => {
  const later = rows.slice(most);
  later.forEach((row) => row.classList.add("off-paper"));
  put(note, later.length ? word("print.left_out").replace("{n}", amount({ n: later.length, d: 0 })) : "");
};

let events = [];
const showEvents = () => {
  const kind = $("event-kind").value, part = $("event-text").value.toLowerCase();
  const shown = events.filter((e) => (!kind || (kind === "notable" ? e.mark : e.kind === kind))
    && (!part || (sentence(e.said) + " " + word(e.kind)).toLowerCase().includes(part)));
  $("events").hidden = !shown.length;
  $("events-empty").hidden = shown.length > 0;
  put($("events-empty"), word(!events.length ? "events.none" : kind === "notable" && !part ? "events.quiet" : "events.no_match"));
  const lines = shown.map((e) => {
    const row = make("tr"), kindCell = make("td", word(e.kind));
    if (e.mark) kindCell.className = "kind m-" + e.mark;
    row.append(make("td", e.ended ? `${time(e.t)} – ${time(e.ended)}` : e.lasts ? word("since.at").replace("{at}", time(e.t)) : time(e.t), "when"), kindCell, make("td", sentence(e.said)));
    if (e.do) row.lastChild.append(make("p", sentence(e.do), "do"));
    return row;
  });
  keepOffPaper(lines, EVENTS_PRINTED, $("events-left"));
  $("events").tBodies[0].replaceChildren(...lines);
};
export const openProblems = () => events.filter((e) => e.lasts).length;
export const takeEvents = (list) => {
  events = list;
  put($("open-count"), amount({ n: openProblems(), d: 0 }));
  $("open-count").hidden = !openProblems();
  const chooser = $("event-kind"), there = new Set([...chooser.options].map((o) => o.value));
  for (const kind of new Set(list.map((e) => e.kind))) if (!there.has(kind)) {
    const option = make("option", word(kind));
    option.value = kind;
    chooser.append(option);
  }
  showEvents();
};

let fixes = [], older = [], oldest = null, asked = false;
const same = (c) => `${c.k} ${c.error}`;
// Beyond this the oldest of what was fetched go from this browser; they can be fetched again.
const MOST_LINES = 5000;
const showCorrections = () => {
  const error = $("correction-error").value, shown = [...fixes, ...older].filter((c) => !error || c.error === error);
  $("corrections").hidden = !shown.length;
  $("corrections-empty").hidden = shown.length > 0;
  const lines = shown.map((c) => {
    const row = make("tr");
    const by = [...c.movers.map(([input, v]) => `${input} ${amount(v)}`), `${word("corrections.rest")} ${amount(c.rest)}`].join(", ");
    row.append(make("td", time(c.t), "when"), named(c.error, "td"), make("td", `${amount({ ...c.estimate, u: "" })} ± ${amount(c.half)}`, "right"),
      make("td", by), make("td", c.experts.map(([kind, share]) => `${atom(kind)} ${amount(share)}`).join(", ")),
      make("td", c.measured ? time(c.measured) : "–", "when"));
    return row;
  });
  keepOffPaper(lines, CORRECTIONS_PRINTED, $("corrections-left"));
  $("corrections").tBodies[0].replaceChildren(...lines);
};
const offerErrors = (list) => {
  const chooser = $("correction-error"), there = new Set([...chooser.options].map((o) => o.value));
  for (const error of new Set(list.map((c) => c.error))) if (!there.has(error)) chooser.append(make("option", error));
};
// Lines that the server no longer sends stay where older ones were fetched, or there would be a gap.
const keepOlder = (lines) => {
  const now = new Set(fixes.map(same)), known = new Map([...lines, ...older].map((c) => [same(c), c]));
  older = [...known.values()].filter((c) => !now.has(same(c))).sort((a, b) => b.k - a.k).slice(0, MOST_LINES);
};
export const takeCorrections = (list) => {
  const before = fixes;
  fixes = list;
  if (asked) keepOlder(before);
  offerErrors(list);
  showCorrections();
};
let asking = false;
const fetchOlder = async () => {
  if (asking) return;
  asking = true;
  const from = oldest ?? (fixes.length ? fixes.at(-1).t : null);
  const { ok, told } = await answerTo(`/corrections/${encodeURIComponent(machine)}` + (from ? `?before=${encodeURIComponent(from)}` : "")), found = ok ? told : { lines: [], before: null, why: told };
  asking = false;
  if (found.why) { put($("corrections-older-note"), word("corrections.no_older").replace("{why}", () => atom(found.why))); return; }
  put($("corrections-older-note"), found.before ? "" : word("corrections.no_more"));
  $("corrections-older").disabled = !found.before;
  asked = true;
  oldest = found.before ?? oldest;
  keepOlder(found.lines);
  offerErrors(found.lines);
  showCorrections();
};
const NEAR_END_PX = 40;

// By week, from the store: again each hour, and sooner while the gateway does not answer.
// answers: whether it does
export const showWeeks = async (answers) => {
  if (!answers()) { setTimeout(showWeeks, 1000, answers); return; }
  const { ok, told } = await answerTo(`/scatter/${encodeURIComponent(machine)}`), { weeks, why } = ok ? told : { weeks: null, why: told };
  $("weeks").hidden = !weeks || !weeks.length;
  $("weeks-empty").hidden = !$("weeks").hidden;
  put($("weeks-empty"), weeks ? word("weeks.none") : word("weeks.unknown").replace("{why}", () => atom(why)));
  $("weeks").tBodies[0].replaceChildren(...(weeks || []).map((w) => {
    const row = make("tr"), begins = make("th", date.format(new Date(w.t * 1e3)));
    begins.scope = "row";
    row.append(begins, ...[w.n, w.median, w.most].map((v) => make("td", amount(v), "right")));
    return row;
  }));
  setTimeout(showWeeks, weeks ? 3600e3 : 10e3, answers);
};

export const readyTables = () => {
  $("event-kind").addEventListener("change", showEvents);
  $("event-text").addEventListener("input", showEvents);
  $("correction-error").addEventListener("change", showCorrections);
  $("corrections-older").addEventListener("click", fetchOlder);
  const box = $("corrections").parentNode;
  box.addEventListener("scroll", () => {
    if (!$("corrections-older").disabled && box.scrollTop + box.clientHeight > box.scrollHeight - NEAR_END_PX) fetchOlder();
  });
};

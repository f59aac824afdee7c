// Micrometres per kelvin by week, from the gateway's store: again each hour, and sooner while it does not answer.
import { machine } from "./choice.js";
import { $, make, named, put } from "./elements.js";
import { amount, answerTo, atom, date, word } from "./words.js";

const UNHEARD_MS = 1000, UNKNOWN_MS = 10e3, KNOWN_MS = 3600e3;

const heading = (text) => {
  const cell = make("th", text, "right");
  cell.scope = "col";
  return cell;
};
const row = (e) => {
  const found = make("tr"), name = named(e.error, "th"), first = e.slopes.findIndex((slope) => slope.n !== null);
  name.scope = "row";
  found.append(name, make("td", e.temperature),
    ...e.slopes.map((slope, i) => make("td", amount(i === first ? { ...slope, u: e.unit } : slope), "right")), make("td", amount(e.follows), "right"));
  return found;
};
let own = null;  // headings that the table has around those of the weeks
const show = ({ weeks, errors, why }) => {
  const found = weeks && errors.length > 0;
  $("sensitivity").hidden = !found;
  $("sensitivity-empty").hidden = found;
  put($("sensitivity-empty"), weeks ? word("sensitivity.none") : word("sensitivity.unknown").replace("{why}", () => atom(why)));
  if (!found) return;
  const table = $("sensitivity").querySelector("table"), head = table.tHead.rows[0];
  own ??= [...head.cells];
  head.replaceChildren(...own.slice(0, 2), ...weeks.map((week) => heading(date.format(new Date(week * 1e3)))), own[2]);
  table.tBodies[0].replaceChildren(...errors.map(row));
};
// answers: whether the gateway does
export const showSensitivity = async (answers) => {
  if (!answers()) { setTimeout(showSensitivity, UNHEARD_MS, answers); return; }
  const { ok, told } = await answerTo(`/sensitivity/${encodeURIComponent(machine)}`), found = ok ? told : { weeks: null, errors: [], why: told };
  show(found);
  setTimeout(showSensitivity, found.weeks ? KNOWN_MS : UNKNOWN_MS, answers);
};

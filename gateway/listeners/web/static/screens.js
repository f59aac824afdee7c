// The screens of a machine: each has an address, so that the browser's Back works.
import { $, make } from "./elements.js";

const NAMES = ["now", "time", "why", "sensors", "log"];
const paper = matchMedia("print");
// sees: whether a screen is seen; on paper all are
const shown = { screen: "now", axis: "Z", body: "", printed: false, sees: (screen) => shown.printed || shown.screen === screen };
export const AXES = ["X", "Y", "Z"];
const watchers = [];
let chosen = false, led = false;
// Calls `change` with what is shown: whenever that changes, also to be printed, and at once.
export const watch = (change) => { watchers.push(change); change(shown); };
const read = () => {
  const [screen, what = ""] = decodeURIComponent(location.hash.slice(1)).split("/");
  if (NAMES.includes(screen)) shown.screen = screen;
  if (AXES.includes(what)) [shown.axis, chosen] = [what, true];
  if (shown.screen === "sensors") shown.body = screen === "sensors" ? what : "";
  document.body.dataset.screen = shown.screen;
  for (const link of document.querySelectorAll("#rail [data-screen]"))
    if (link.dataset.screen === shown.screen) link.setAttribute("aria-current", "page"); else link.removeAttribute("aria-current");
  for (const link of document.querySelectorAll('[data-choice="axis"] a'))
    if (link.textContent === shown.axis) link.setAttribute("aria-current", "true"); else link.removeAttribute("aria-current");
  watchers.forEach((change) => change(shown));
};
// Until somebody chooses an axis, the other screens open with the one that is off most; an open one does not change under anybody's eyes.
export const lead = (axis) => {
  if (chosen || led && shown.screen !== "now") return;
  led = true;
  if (axis === shown.axis) return;
  shown.axis = axis;
  read();
};
export const readyScreens = () => {
  document.body.classList.toggle("panel", new URLSearchParams(location.search).has("panel"));
  document.querySelector('[data-choice="axis"]').replaceChildren(...AXES.map((axis) => Object.assign(make("a", axis), { href: `#time/${axis}` })));
  paper.addEventListener("change", () => { shown.printed = paper.matches; watchers.forEach((change) => change(shown)); });
  addEventListener("hashchange", () => { read(); $("main").scrollTop = 0; });
  read();
};

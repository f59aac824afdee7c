// The machine that the page shows, and what this browser asks to see of it.
import { $ } from "./elements.js";

export const machine = document.body.dataset.machine;

// The choice of this browser, kept by machine.
const kept = () => { try { return JSON.parse(localStorage.getItem("asked " + machine)) || {}; } catch { return {}; } };
export const query = () => {
  const found = new URLSearchParams();
  for (const [name, value] of Object.entries(kept())) if (value !== "") found.set(name, value);
  return found.toString();
};

// changed: called after each new choice
export const readyChoice = (changed) => {
  const form = $("asked"), inputs = [...form.querySelectorAll("input")];
  const fill = () => { const own = kept(); for (const i of inputs) i.value = own[i.name] ?? i.dataset.declared; };
  const keep = (own) => { localStorage.setItem("asked " + machine, JSON.stringify(own)); fill(); changed(); };
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    keep(Object.fromEntries(inputs.filter((i) => i.value !== i.dataset.declared).map((i) => [i.name, i.value])));
  });
  form.addEventListener("reset", (event) => { event.preventDefault(); keep({}); });
  fill();
};

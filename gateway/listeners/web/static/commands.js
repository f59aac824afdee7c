// The buttons that give the gateway commands.
import { machine } from "./choice.js";
import { $, put } from "./elements.js";
import { atom, word } from "./words.js";

// Present only with a token, for users who may give commands by the settings.
const commands = $("commands");
let paused = false;
export const showCommands = (v) => {
  if (!commands) return;
  paused = v.paused;
  commands.hidden = !(v.commands && v.alive);
  put($("command-pause"), word(paused ? "command.resume" : "command.pause"));
};
export const hideCommands = () => { if (commands) commands.hidden = true; };
export const readyCommands = () => {
  if (!commands) return;
  const dialog = $("confirm"), answer = (text) => put($("command-answer"), text);
  let chosen = null;
  const choose = (name) => {
    chosen = name;
    put($("confirm-title"), word("command." + name));
    put($("confirm-text"), word("command." + name + "_text").replace("{machine}", () => machine));
    dialog.showModal();
  };
  $("command-measure").addEventListener("click", () => choose("measure"));
  $("command-reference").addEventListener("click", () => choose("reference"));
  $("command-pause").addEventListener("click", () => choose(paused ? "resume" : "pause"));
  $("confirm-no").addEventListener("click", () => dialog.close());
  $("confirm-yes").addEventListener("click", async () => {
    dialog.close();
    answer(word("command.sent"));
    try {
      const reply = await fetch(`/command/${encodeURIComponent(machine)}/${chosen}`, {
        method: "POST", headers: { "x-command-token": commands.dataset.token } });
      const told = await reply.json();
      answer(word(told.accepted ? "command.accepted" : "command.refused").replace("{text}", () => atom(told.said)));
    } catch { answer(word("command.failed")); }
  });
};

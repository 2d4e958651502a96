/** Colours and language, chosen the same way on every page. */

import { fillWords, language, LANGUAGES, say, timeLeft } from "./words.js";
import { keep, kept } from "./settings.js";

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

export function runTheme() {
  const light = matchMedia("(prefers-color-scheme: light)");
  let chosen = kept("theme");
  const tell = () => {
    const theme = chosen === "light" || chosen === "dark" ? chosen : light.matches ? "light" : "dark";
    document.documentElement.dataset.theme = theme;
    find("theme").setAttribute("aria-pressed", String(theme === "light"));
  };
  find("theme").addEventListener("click", () => {
    chosen = document.documentElement.dataset.theme === "light" ? "dark" : "light";
    keep("theme", chosen);
    tell();
  });
  light.addEventListener("change", tell);
  tell();
}

export function runLanguage() {
  const select = /** @type {HTMLSelectElement} */ (find("language"));
  for (const [name, words] of Object.entries(LANGUAGES)) {
    const option = document.createElement("option");
    option.value = name;
    option.lang = name;
    option.textContent = words.language_name;
    select.append(option);
  }
  select.addEventListener("change", () => (language.value = select.value));
  language.follow((name) => (select.value = name));
}

/** The page's words in the language that is chosen, now and whenever it is another. */
export function runWords() {
  language.follow((name) => {
    document.documentElement.lang = name;
    fillWords(document);
  });
}

/** Say that the server is gone or does not know this page any more, which is of no use then. @param {import("./connection.js").State} state @param {string} words */
export function tellLost(state, words) {
  const lost = find("lost");
  lost.hidden = words === "";
  if (lost.textContent !== words) lost.textContent = words;
  for (const part of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("body > :is(header, main, .time-bar)"))) {
    part.inert = state === "stranger";
  }
}

/** Say below what is waited for that this machine gets ready, and for how long. @param {HTMLElement} shown @param {import("./connection.js").Message} message */
export function showCompiling(shown, message) {
  shown.hidden = message.fraction === null;
  if (message.fraction === null) return;
  const percent = String(Math.floor(100 * message.fraction));
  shown.textContent = say("opening_compiling", { percent, left: timeLeft(message.seconds_left) });
}

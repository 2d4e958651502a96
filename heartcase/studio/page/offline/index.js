/** The list of a site's cases: its words and figures in the language that was chosen. */

import { runLanguage, runTheme } from "../shared/looks.js";
import { fillWords, figure, isWord, language, say } from "../shared/words.js";

runTheme();
runLanguage();
language.follow((name) => {
  document.documentElement.lang = name;
  fillWords(document);
  for (const one of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-say]"))) {
    const word = one.dataset.say ?? "";
    const values = Object.entries(/** @type {Record<string, number>} */ (JSON.parse(one.dataset.values ?? "{}")));
    const shown = values.map(([key, value]) => [key, figure(value, Number.isInteger(value) && key === "count" ? 0 : 1)]);
    if (isWord(word)) one.textContent = say(word, Object.fromEntries(shown));
  }
  for (const link of /** @type {NodeListOf<HTMLAnchorElement>} */ (document.querySelectorAll("[data-titles]"))) {
    const titles = JSON.parse(link.dataset.titles ?? "{}");
    const own = name in titles ? name : "en";
    link.textContent = titles[own];
    link.lang = own;
    link.search = `?lang=${name}`;
  }
});
document.body.dataset.ready = "true";

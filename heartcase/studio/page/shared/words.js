/** The page's words, in the language that was chosen. */

import { SIDES } from "./geometry.js";
import { words as de } from "../words/de.js";
import { words as en } from "../words/en.js";
import { words as preparingDe } from "../words/preparing_de.js";
import { words as preparingEn } from "../words/preparing_en.js";
import * as namesDe from "../words/structures_de.js";
import * as namesEn from "../words/structures_en.js";
import { keep, kept } from "./settings.js";
import { Signal } from "./signal.js";

const english = { ...en, ...preparingEn };
/** @typedef {keyof typeof english} Word */
/** @typedef {Record<string, string | number>} Values */

/** @type {Record<string, Record<Word, string>>} */
export const LANGUAGES = { en: english, de: { ...de, ...preparingDe } };

/** @type {Signal<string>} */
export const language = new Signal(firstLanguage());
language.listen((chosen) => keep("language", chosen));

function firstLanguage() {
  // a page that led here says in which language
  const asked = new URLSearchParams(globalThis.location?.search ?? "").get("lang");
  const wanted = [asked, kept("language"), ...(globalThis.navigator?.languages ?? [])];
  for (const name of wanted) {
    const short = name?.slice(0, 2).toLowerCase();
    if (short && short in LANGUAGES) return short;
  }
  return "en";
}

/**
 * A sentence of the page, with {values} put in.
 * @param {Word} key
 * @param {Values} [values]
 */
export function say(key, values = {}) {
  const text = LANGUAGES[language.value][key];
  return text.replace(/\{(\w+)\}/g, (_, name) => String(values[name] ?? ""));
}

/**
 * A sentence that there may be none for, as of a stage's name that came from the server.
 * @param {string} key
 * @returns {key is Word}
 */
export function isWord(key) {
  return key in english;
}

/** What structures are called, by language. */
const NAMES = /** @type {Record<string, {structures: Record<string, string>, wallOf: (name: string) => string, septumOf: (one: string, other: string) => string}>} */ ({ de: namesDe, en: namesEn });

/**
 * A structure's name as the language calls it; one that the vocabulary does not have stays as it is. Recipes and cases
 * hold the English names: what is written or asked for is never this.
 * @param {string} name
 * @returns {string}
 */
export function structureName(name) {
  const { structures, wallOf, septumOf } = NAMES[language.value];
  const known = structures[name.toLowerCase()];
  if (known !== undefined) return known;
  const wall = /^(.+) wall$/.exec(name);
  if (wall && wall[1].toLowerCase() in structures) return wallOf(structureName(wall[1]));
  const septum = /^(.+)-(.+) septum \(grown\)$/.exec(name);
  if (septum && septum.slice(1).every((one) => one.toLowerCase() in structures)) return septumOf(structureName(septum[1]), structureName(septum[2]));
  return name;
}

/** What a case says of its use, in the page's language where it is what all cases say. @param {HTMLElement} shown @param {string} notice as the case has it */
export function showNotice(shown, notice) {
  if (notice === english.case_notice) shown.dataset.word = "case_notice";
  else delete shown.dataset.word;
  shown.textContent = notice === english.case_notice ? say("case_notice") : notice;
}

/**
 * A number as the language writes it.
 * @param {number} value
 * @param {number} digits behind the point
 */
export function figure(value, digits) {
  return value.toLocaleString(language.value, { minimumFractionDigits: digits, maximumFractionDigits: digits });
}

/** A position as text: "L 12.3  P 4.0  H 1.2" in mm. @param {import("./geometry.js").Vector} mm @param {string} [between] */
export function positionText(mm, between = "  ") {
  return mm.map((value, axis) => `${SIDES[2 * axis + (value < 0 ? 0 : 1)]} ${figure(Math.abs(value), 1)}`).join(between);
}

/** How long something still takes, in words. @param {number | null} seconds null where that is not known yet */
export function timeLeft(seconds) {
  if (seconds === null) return say("start_compiling_some");
  const minutes = Math.ceil(seconds / 60);
  return say(minutes > 1 ? "start_compiling_left" : "start_compiling_soon", { minutes: String(minutes) });
}

/**
 * Fill in every element's words: `data-word` is its text, `data-label` its accessible name and tip.
 * @param {ParentNode} root
 */
export function fillWords(root) {
  for (const element of root.querySelectorAll("[data-word]")) {
    element.textContent = say(/** @type {Word} */ (element.getAttribute("data-word")));
  }
  for (const element of root.querySelectorAll("[data-label]")) {
    const label = say(/** @type {Word} */ (element.getAttribute("data-label")));
    element.setAttribute("aria-label", label);
    if (element.matches("button, input, select, [data-tip]")) element.setAttribute("title", label);
  }
}

/** The start page: what was opened last, folders and series on this machine, sample cases. */

import { element } from "../shared/elements.js";
import { Connection, Lost, Refused } from "../shared/connection.js";
import { runLanguage, runTheme, tellLost } from "../shared/looks.js";
import { fillWords, language, say, timeLeft } from "../shared/words.js";
import { Chooser } from "./chooser.js";
import { Lists } from "./lists.js";
import { Series } from "./series.js";

/** @typedef {import("../shared/connection.js").Message} Message */
/** @typedef {import("../shared/connection.js").Problem} Problem */
/** @typedef {Record<string, unknown> & {do: string}} Request */

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/** What was told last of compiling. @type {Message | null} */
let compiling = null;
/** What is said below the chooser: kept, so that another language can say it anew. @type {() => Node[]} */
let saying = () => [];
/** @param {() => Node[]} words */
function tell(words) {
  saying = words;
  find("start-live").replaceChildren(...words());
}

/** @param {readonly Problem[]} problems @param {Request} request */
function problemLines(problems, request) {
  const list = element("ul", "problems");
  const path = String(request.folder ?? request.path ?? "");
  list.append(...problems.map(({ place, message }) => element("li", "", place === "outside" ? say("start_outside", { path }) : message)));
  return [element("strong", "", say("refused")), list];
}

language.follow((name) => {
  document.documentElement.lang = name;
  fillWords(document);
  if (compiling !== null) showCompiling(compiling);
  find("start-live").replaceChildren(...saying());
});
runTheme();
runLanguage();

const url = new URL("/starting", location.href);
url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
url.search = url.hash = "";
const connection = new Connection(url.href, hear, () => undefined, (error) => console.error(error));

/**
 * Ask, and say what comes of it.
 * @param {Request} request
 * @param {(answer: Message) => void} [then]
 * @param {boolean} [isQuiet] whether a refusal goes without a word: nobody asked
 */
async function ask(request, then, isQuiet = false) {
  tell(() => [document.createTextNode(say("start_working"))]);
  document.body.dataset.busy = "true";
  try {
    const answer = await connection.ask(request);
    tell(() => []);
    if (answer.kind === "go") location.assign(answer.address);
    else then?.(answer);
  } catch (error) {
    if (error instanceof Refused) tell(() => (isQuiet ? [] : problemLines(error.problems, request)));
    else if (error instanceof Lost) tell(() => []);
    else throw error;
  } finally {
    document.body.dataset.busy = "false";
  }
}

const series = new Series(ask);
const chooser = new Chooser(ask, series);
const lists = new Lists(ask, () => chooser.folder);
let isBegun = false;

/** How far this installation is with what it compiles once. @param {Message} message */
function showCompiling(message) {
  compiling = message;
  find("compiling").hidden = message.fraction === null;
  if (message.fraction === null) return;
  const bar = /** @type {HTMLProgressElement} */ (find("compiling-bar"));
  bar.value = message.fraction;
  find("compiling-left").textContent = timeLeft(message.seconds_left);
}

/** @param {Message} message */
function hear(message) {
  if (message.kind === "samples") lists.showSamples(message.samples);
  if (message.kind === "compiling") showCompiling(message);
  if (message.kind !== "start") return;
  lists.showRecent(message.recent);
  if (isBegun) return;
  isBegun = true;
  const wasClosed = location.hash === "#closed";
  history.replaceState(null, "", "/");
  void chooser.go(null).then(() => {
    if (wasClosed) tell(() => [document.createTextNode(say("start_closed"))]);
    else if (message.looks) chooser.look(true);
  });
}

// a browser would leave the page and show the file, and it does not tell where that lies
for (const name of /** @type {const} */ (["dragover", "drop"])) {
  document.addEventListener(name, (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    if (name === "drop") tell(() => [document.createTextNode(say("start_dropped"))]);
  });
}

connection.state.follow((state) => {
  tellLost(state, state === "lost" ? say("start_lost") : state === "stranger" ? say("stranger") : "");
  document.body.dataset.state = state;
});
connection.open();

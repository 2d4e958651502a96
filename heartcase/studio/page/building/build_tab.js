/** The tab that builds: stages, time left, what is reused; then what came of it. */

import { paintHere, wallLabel } from "../painting/panel/paint_here.js";
import { element, problemList } from "../shared/elements.js";
import { Connection, Lost, Refused } from "../shared/connection.js";
import { figure, isWord, language, say } from "../shared/words.js";
import { Approval } from "./approval.js";
import { Contacts, WALL_MM } from "./contacts.js";
import { Results } from "./results.js";

/** @typedef {import("../shared/connection.js").Problem} Problem */
/** @typedef {{stage: string, state: "waiting" | "running" | "computed" | "reused", seconds: number}} Step */
/** @typedef {import("./warning_words.js").Parts} Parts */
/** @typedef {{text: string, grade: string, places_mm: import("../shared/geometry.js").Vector[], code: string, parts: Parts}} Warning */
/** @typedef {{between: string[], area_mm2: number, center_mm: import("../shared/geometry.js").Vector, verdict: string, reach_mm: number | null}} Opening */
/** @typedef {{between: string[], thickness_mm: number, area_mm2: number, center_mm: import("../shared/geometry.js").Vector, radius_mm: number,
 *   state: "grown" | "opened" | "confirmed"}} Grown */
/**
 * @typedef {{sha256: string, name: string, notice: string, warnings: Warning[], volumes_ml: Record<string, number>,
 *   openings: Opening[], grown: Grown[], node_count: number, cell_mm: number, tissue_volume_ml: number, has_report: boolean,
 *   approval: {state: string, words: string, role: string | null, time: string | null}}} Case
 */
/**
 * @typedef {{is_running: boolean, is_cancelled: boolean, steps: Step[], compiling: [number, number] | null,
 *   expected: {elapsed: number, left: {seconds: number, after: number} | null} | null, problems: Problem[], changed: boolean | null,
 *   age: "current" | "older" | "unknown", case: Case | null, before_ml: Record<string, number>}} State
 */

const TICK_MS = 500;
const SIGNS = { waiting: "○", running: "●", computed: "✓", reused: "=" };

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

export class BuildTab {
  /** @type {State | null} */
  #state = null;
  #since = 0;
  #wasRunning = false;
  #isAboutApproval = false;
  /** Problems of what was asked for last. @type {readonly Problem[]} */
  #refused = [];

  /**
   * @param {import("../painting/studio.js").Studio} studio
   * @param {import("../painting/pictures/views.js").Views} views
   * @param {import("../shaping/shaping.js").Shaping} shaping
   * @param {import("../shaping/shaping.js").Ask} ask of the recipe's page
   * @param {(error: unknown) => void} onFault
   */
  constructor(studio, views, shaping, ask, onFault) {
    this.onFault = onFault;
    this.contacts = new Contacts(shaping, ask, (between) => {
      const value = wallLabel(studio.labels.value, between, shaping.shape.value?.structures);
      return value === null ? null : (mm) => paintHere(studio, views, { value, mm, mostMm: WALL_MM });
    });
    this.results = new Results(studio, views, this.contacts);
    this.approval = new Approval((request) => this.#ask(request), this.results);
    const url = new URL(location.pathname.replace("/prepare/", "/building/"), location.href);
    url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    this.connection = new Connection(url.href, (message) => this.#hear(message), () => undefined, onFault);
    /** @type {HTMLAnchorElement} */ (find("report-link")).href = location.pathname.replace("/prepare/", "/report/");
    find("build").addEventListener("click", () => void this.#ask({ do: "build" }));
    find("build-cancel").addEventListener("click", () => void this.#ask({ do: "cancel" }));
    for (const id of ["operate", "operate-above", "operate-approved"]) find(id).addEventListener("click", () => void this.#ask({ do: "operate" }));
    find("report-link").addEventListener("click", () => this.approval.reportWasOpened());
    this.connection.state.listen(() => this.#draw());
    language.listen(() => this.#draw());
    setInterval(() => this.#tellTime(), TICK_MS);
    this.connection.open();
  }

  /** @param {Record<string, unknown> & {do: string}} request */
  async #ask(request) {
    this.#refused = [];
    // what was wrong with an approval is said beside its button
    this.#isAboutApproval = request.do === "approve" || request.do === "withdraw";
    try {
      const answer = await this.connection.ask(request);
      if (answer.address) location.assign(answer.address);
    } catch (error) {
      if (error instanceof Refused) this.#refused = error.problems;
      else if (!(error instanceof Lost)) this.onFault(error);
    }
    this.#draw();
    if (this.#isAboutApproval) find("approve-problems").scrollIntoView({ block: "nearest" });
  }

  /** @param {import("../shared/connection.js").Message} message */
  #hear(message) {
    if (message.kind !== "build") return;
    this.#state = /** @type {State} */ (/** @type {unknown} */ (message));
    this.#since = performance.now();
    this.#draw();
  }

  #draw() {
    const state = this.#state;
    if (state === null) return;
    const isOpen = this.connection.state.value === "open";
    const { is_running: isRunning, case: made } = state;
    document.body.dataset.building = String(isRunning);
    find("build").hidden = isRunning;
    find("build-cancel").hidden = !isRunning;
    for (const id of ["build", "build-cancel", "operate", "operate-above", "operate-approved"]) /** @type {HTMLButtonElement} */ (find(id)).disabled = !isOpen;
    find("build").textContent = say(made ? "build_again" : "build_now");
    find("build-age").textContent = isRunning ? say("build_running") : this.#age(state);
    find("build-age").dataset.age = made && !isRunning ? state.age : "none";
    find("tab-build").dataset.age = made && !isRunning ? state.age : "none";
    const isShown = isRunning || state.problems.length > 0 || state.changed !== null || state.is_cancelled;
    const details = /** @type {HTMLDetailsElement} */ (find("build-details"));
    details.hidden = !isShown || state.steps.length === 0;
    if (isRunning !== this.#wasRunning) details.open = isRunning;
    this.#wasRunning = isRunning;
    // a scan is made for few recipes, and what a whole build left out it had no work for
    const isWhole = !isRunning && state.changed !== null;
    const rows = state.steps.filter((one) => one.state !== "waiting" || (one.stage !== "scan" && !isWhole));
    find("build-steps").replaceChildren(...rows.map((one) => stepRow(one)));
    const problems = this.#isAboutApproval ? state.problems : [...this.#refused, ...state.problems];
    const refusals = this.#isAboutApproval ? this.#refused : [];
    find("approve-problems").hidden = refusals.length === 0;
    find("approve-problems").replaceChildren(problemList(refusals));
    find("build-problems").hidden = problems.length === 0;
    find("build-problems").replaceChildren(
      element("strong", "", say(state.problems.length > 0 ? "build_failed" : "refused")),
      problemList(problems),
    );
    find("build-changed").textContent = isRunning ? "" : this.#outcome(state);
    find("build-case").hidden = find("operate-above").hidden = made === null;
    if (made) {
      this.contacts.setCurrent(state.age === "current" && !isRunning);
      this.results.show(made, state.before_ml);
      this.approval.show(made, isRunning || !isOpen);
    }
    this.#tellTime();
  }

  /** @param {State} state */
  #age({ case: made, age }) {
    return made ? say(age === "current" ? "build_current" : age === "older" ? "build_older" : "build_unknown", { name: made.name }) : say("build_none");
  }

  /** What the last build did, in a line. @param {State} state */
  #outcome({ is_cancelled: isCancelled, changed, steps, before_ml: beforeMl }) {
    if (isCancelled) return say("build_cancelled");
    if (changed === null) return "";
    const computed = steps.filter(({ state }) => state === "computed").map(({ stage }) => title(stage));
    if (!changed) return say("build_unchanged");
    return say(Object.keys(beforeMl).length > 0 ? "build_changed" : "build_first", { stages: computed.join(", ") });
  }

  #tellTime() {
    const state = this.#state;
    const time = find("build-time");
    const bar = /** @type {HTMLProgressElement} */ (find("build-bar"));
    bar.hidden = time.hidden = !state?.is_running;
    if (!state?.is_running) return;
    const words = [];
    const isCompiling = state.compiling !== null && state.compiling[0] < state.compiling[1];
    // what takes as long as it takes for the first time is not guessed
    if (state.expected?.left && !isCompiling) {
      const { elapsed, left: { seconds, after } } = state.expected;
      const passed = elapsed + (performance.now() - this.#since) / 1000;
      const left = Math.max(seconds - passed, 0) + after;
      bar.value = Math.min(passed / Math.max(seconds, 0.1), 0.97);
      words.push(left < 1 ? say("build_nearly") : left < 120 ? say("build_seconds_left", { n: figure(left, 0) }) : say("build_minutes_left", { n: figure(left / 60, 0) }));
    } else bar.removeAttribute("value");
    if (state.compiling && isCompiling) {
      words.push(say("build_compiling", { done: state.compiling[0], total: state.compiling[1] }));
    }
    const text = words.join(" · ");
    if (time.textContent !== text) time.textContent = text;
  }
}

/** @param {string} stage */
function title(stage) {
  const word = `build_stage_${stage}`;
  return isWord(word) ? say(word) : stage;
}

/** @param {Step} step */
function stepRow({ stage, state, seconds }) {
  const row = element("li", state);
  const sign = element("span", "tick", SIGNS[state]);
  sign.setAttribute("aria-hidden", "true");
  const result = state === "computed" ? `${figure(seconds, 1)} s` : say(`build_state_${/** @type {"waiting" | "running" | "reused"} */ (state)}`);
  row.append(sign, element("span", "name", title(stage)), element("span", "figure", result));
  return row;
}

/** The guided tour beside the heart: text, questions, and from step to step. All text is set as text, never as markup. */

import { element, problemList } from "../shared/elements.js";
import { language, say } from "../shared/words.js";

/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {{text: string, strong: boolean, emphasis: boolean}} Piece */
/** @typedef {{kind: "paragraph", pieces: Piece[]} | {kind: "list", is_numbered: boolean, items: Piece[][]}} Block */
/** @typedef {{pieces: Piece[], is_right: boolean, reason: Piece[][]}} Choice */
/** @typedef {{text: string, choices: Choice[]}} Question */
/** @typedef {{title: string, blocks: Block[], question: Question | null, scene: Scene, acts: boolean}} Step */
/** @typedef {{title: string, language: string, blocks: Block[], steps: Step[]}} Tour */
/** @typedef {{place: string, message: string}} Problem */
/** @typedef {{show: (scene: Scene) => void, enter: (tour: number, step: number | null) => void}} Does */

/** @type {Scene} */
const START = { view: null, hidden: [], plane: null, stretch: false };

/** @param {readonly Piece[]} pieces */
function spelled(pieces) {
  return pieces.map(({ text, strong, emphasis }) => {
    if (!strong && !emphasis) return document.createTextNode(text);
    const made = document.createElement(strong ? "strong" : "em");
    if (strong && emphasis) made.append(element("em", "", text));
    else made.textContent = text;
    return made;
  });
}

/** @param {"p" | "li" | "span"} tag @param {readonly Piece[]} pieces */
function told(tag, pieces) {
  const made = element(tag);
  made.append(...spelled(pieces));
  return made;
}

/** @param {readonly Block[]} blocks */
function written(blocks) {
  return blocks.map((block) => {
    if (block.kind === "paragraph") return told("p", block.pieces);
    const list = element(block.is_numbered ? "ol" : "ul");
    list.append(...block.items.map((item) => told("li", item)));
    return list;
  });
}

export class TourPanel {
  /** @type {readonly Tour[]} */
  tours = [];
  /** Number of the tour that is chosen; -1 for none. */
  tour = -1;
  /** Number of the step that is shown; -1 before the first. */
  step = -1;
  /** @type {readonly Problem[]} */
  #problems = [];
  #known = "";
  /** What came of each question that was answered, by its step: whether it was right at first. @type {Map<number, boolean>} */
  #answered = new Map();
  #state = "ready";
  /** @type {readonly Problem[]} */
  #failed = [];

  /** @param {HTMLElement} root @param {Does} does */
  constructor(root, does) {
    this.does = does;
    this.text = element("div", "tour-text");
    this.text.tabIndex = -1;
    this.said = element("p", "hidden-words");
    this.said.setAttribute("role", "status");
    this.state = element("p", "tour-state");
    this.state.setAttribute("role", "status");
    this.bar = element("div", "tour-bar");
    this.bar.setAttribute("role", "group");
    this.back = this.#button(() => this.go(this.step - 1));
    this.at = element("span", "at figure");
    this.next = this.#button(() => this.go(this.step + 1));
    this.next.classList.add("main");
    this.progress = document.createElement("progress");
    this.again = this.#button(() => this.go(this.step));
    this.end = this.#button(() => this.leave());
    this.bar.append(this.progress, this.back, this.at, this.next, this.again, this.end);
    root.classList.add("tour");
    root.append(this.text, this.said, this.state, this.bar);
    language.follow(() => this.#build());
  }

  get isBegun() {
    return this.tour >= 0 && this.step >= 0;
  }

  /** @param {readonly Tour[]} tours @param {readonly Problem[]} problems */
  setTours(tours, problems) {
    const known = JSON.stringify([tours, problems]);
    if (known === this.#known) return;
    this.#known = known;
    this.tours = tours;
    this.#problems = problems;
    this.#choose(tours.length === 1 ? 0 : -1);
  }

  /** What the server says of the step that it goes to. @param {{tour: number, step: number, state: string, problems?: Problem[]}} message */
  hear(message) {
    if (message.tour !== this.tour || message.step !== this.step) return;
    this.#state = message.state;
    this.#failed = message.problems ?? [];
    this.#tell();
  }

  /** Go to a step of the tour that is chosen. @param {number} step */
  go(step) {
    const tour = this.tours[this.tour];
    if (tour === undefined || step < 0 || step >= tour.steps.length) return;
    const isOther = step !== this.step;
    this.step = step;
    this.#state = "ready";
    this.#failed = [];
    if (isOther) {
      this.#build();
      this.text.scrollTop = 0;
      this.said.textContent = say("tour_said", { at: step + 1, count: tour.steps.length, title: tour.steps[step].title });
    } else this.#tell();
    this.does.show(tour.steps[step].scene);
    this.does.enter(this.tour, step);
  }

  /** The heart is left to the learner as it is, and all of it is shown. */
  leave() {
    if (!this.isBegun) return;
    const tour = this.tour;
    this.step = -1;
    this.#state = "ready";
    this.#failed = [];
    this.#build();
    this.said.textContent = say("tour_left");
    this.does.show(START);
    this.does.enter(tour, null);
    this.text.querySelector("button")?.focus();
  }

  /** @param {string} key in lower case @returns {(() => void) | null} what it does while a tour is under way */
  action(key) {
    if (!this.isBegun) return null;
    return { q: () => this.go(this.step - 1), m: () => this.go(this.step + 1), h: () => this.go(this.step) }[key] ?? null;
  }

  /** @param {number} tour */
  #choose(tour) {
    this.tour = tour;
    this.step = -1;
    this.#answered.clear();
    this.#build();
  }

  /** @param {() => void} does */
  #button(does) {
    const made = element("button");
    made.type = "button";
    made.addEventListener("click", () => {
      if (made.getAttribute("aria-disabled") !== "true") does();
    });
    return made;
  }

  #build() {
    const tour = this.tours[this.tour];
    this.bar.hidden = !this.isBegun;
    this.bar.setAttribute("aria-label", say("tour"));
    this.text.lang = tour?.language ?? "";
    if (tour === undefined) this.text.replaceChildren(...this.#list());
    else if (this.step < 0) this.text.replaceChildren(...this.#beginning(tour));
    else this.text.replaceChildren(...this.#shown(tour.steps[this.step]));
    this.#tell();
  }

  #list() {
    const found = [];
    if (this.tours.length > 0) {
      const list = element("ul", "tour-list");
      this.tours.forEach(({ title, language: spoken }, number) => {
        const row = element("li");
        const button = this.#button(() => {
          this.#choose(number);
          this.text.querySelector("button")?.focus();
        });
        button.textContent = title;
        button.lang = spoken;
        row.append(button);
        list.append(row);
      });
      found.push(list);
    }
    if (this.#problems.length > 0) {
      found.push(element("p", "", say("tour_wrong")), this.#told(this.#problems));
    }
    return found;
  }

  /** @param {Tour} tour */
  #beginning(tour) {
    const begin = this.#button(() => {
      this.go(0);
      this.next.focus();
    });
    begin.className = "main";
    begin.lang = document.documentElement.lang;
    begin.textContent = say("tour_begin", { count: tour.steps.length });
    const row = element("p");
    row.append(begin);
    const found = [element("h2", "", tour.title), ...written(tour.blocks), row];
    const asked = tour.steps.filter(({ question }) => question !== null).length;
    if (this.#answered.size > 0) {
      const right = [...this.#answered.values()].filter(Boolean).length;
      const score = element("p", "", say("tour_score", { right, answered: this.#answered.size, asked }));
      score.lang = document.documentElement.lang;
      found.push(score);
    }
    if (this.tours.length > 1) {
      const other = this.#button(() => this.#choose(-1));
      other.lang = document.documentElement.lang;
      other.textContent = say("tour_others");
      found.push(other);
    }
    if (this.#problems.length > 0) found.push(element("p", "", say("tour_wrong")), this.#told(this.#problems));
    return found;
  }

  /** @param {Step} step */
  #shown(step) {
    const found = [element("h2", "", step.title), ...written(step.blocks)];
    if (step.question !== null) found.push(this.#asked(step.question, this.step));
    return found;
  }

  /** @param {Question} question @param {number} number of its step */
  #asked(question, number) {
    const form = document.createElement("form");
    const set = document.createElement("fieldset");
    set.append(element("legend", "", question.text));
    const isSeveral = question.choices.filter(({ is_right }) => is_right).length > 1;
    const inputs = question.choices.map((choice) => {
      const row = element("label", "choice");
      const input = document.createElement("input");
      input.type = isSeveral ? "checkbox" : "radio";
      input.name = "answer";
      row.append(input, told("span", choice.pieces));
      set.append(row);
      return input;
    });
    const check = element("button", "", say("tour_check"));
    check.type = "submit";
    check.lang = document.documentElement.lang;
    const outcome = element("div", "outcome");
    outcome.setAttribute("role", "status");
    set.append(check, outcome);
    form.append(set);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const chosen = question.choices.filter((_, at) => inputs[at].checked);
      const words = element("p");
      words.lang = document.documentElement.lang;
      if (chosen.length === 0) {
        words.textContent = say("tour_choose");
        delete outcome.dataset.right;
        outcome.replaceChildren(words);
        return;
      }
      const isRight = question.choices.every(({ is_right }, at) => is_right === inputs[at].checked);
      const isPart = !isRight && chosen.every(({ is_right }) => is_right);
      if (!this.#answered.has(number)) this.#answered.set(number, isRight);
      words.append(element("strong", "", say(isRight ? "tour_right" : isPart ? "tour_part" : "tour_not_right")));
      outcome.dataset.right = String(isRight);
      // of some right answers that are not all, the reasons would tell the others
      const reasons = isPart ? [] : chosen.filter(({ is_right }) => isRight || !is_right);
      outcome.replaceChildren(words, ...reasons.flatMap(({ reason }) => reason.map((pieces) => told("p", pieces))));
    });
    return form;
  }

  #tell() {
    const tour = this.tours[this.tour];
    const count = tour?.steps.length ?? 1;
    this.back.textContent = say("tour_back");
    this.next.textContent = say("tour_next");
    this.again.textContent = say("tour_again");
    this.end.textContent = say("tour_end");
    for (const [button, key] of /** @type {const} */ ([[this.back, "Q"], [this.next, "M"], [this.again, "H"]])) {
      button.title = `${button.textContent} (${key})`;
    }
    this.again.title = `${say("tour_again_says")} (H)`;
    this.back.setAttribute("aria-disabled", String(this.step <= 0));
    this.next.setAttribute("aria-disabled", String(this.step >= count - 1));
    this.at.textContent = say("tour_at", { at: this.step + 1, count });
    this.progress.max = count;
    this.progress.value = this.step + 1;
    this.progress.setAttribute("aria-label", say("tour_at", { at: this.step + 1, count }));
    this.state.dataset.state = this.#state;
    this.state.hidden = !this.isBegun;
    if (this.#state === "failed") this.state.replaceChildren(document.createTextNode(say("tour_failed")), this.#told(this.#failed));
    else this.state.textContent = this.#state === "working" ? say("tour_working") : this.#state === "shown_only" ? say("tour_shown_only") : "";
  }

  /** @param {readonly Problem[]} problems */
  #told(problems) {
    return problemList(problems);
  }
}

/** The keyboard: every tool has a key, and a slice can be painted by keys alone. */

import { keep, kept } from "../../shared/settings.js";
import { Signal } from "../../shared/signal.js";

/** @typedef {import("../pictures/views.js").Views} Views */
/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("./pointers.js").Pointers} Pointers */
/** @typedef {import("./brush.js").Brush} Brush */
/** @typedef {import("./measures.js").Measures} Measures */
/** @typedef {import("../../shared/words.js").Word} Word */
/** @typedef {{undo: () => void, redo: () => void, nextPlace: () => void, placeRight: () => void, placeWrong: () => void, shape: () => void, removeShape: () => boolean}} Actions */

/** Held longer than this, the space bar was not tapped. */
const TAP_MS = 350;

/** Keys and what they do, for the help: in the order in which they are shown. @type {readonly (readonly [string, Word])[]} */
export const HELP = [
  ["B  X  V", "help_tools"],
  ["1 … 9  0", "help_pick"],
  ["[  ]", "help_size"],
  ["E  Alt", "help_erase"],
  ["Z  Y", "help_undo"],
  ["↑ ↓", "help_step"],
  ["Shift + ↑ ↓ ← →", "help_nudge"],
  ["Enter", "help_dab"],
  ["Space", "help_space"],
  ["N", "help_next"],
  ["R", "help_right"],
  ["W", "help_wrong"],
  ["M  A", "help_measure"],
  ["S", "help_shape"],
  ["Delete", "help_delete"],
  ["L  O", "help_labels"],
  ["T  F", "help_tile"],
  ["J  K", "help_turn"],
];

export class Shortcuts {
  /** Keys without Ctrl can be switched off: speech input and shaky hands press them unasked. */
  areOn = new Signal(kept("keys") !== "off");
  #spaceAt = -Infinity;

  /**
   * @param {Studio} studio
   * @param {Views} views
   * @param {Pointers} pointers
   * @param {Brush} brush
   * @param {Measures} measures
   * @param {Actions} actions
   */
  constructor(studio, views, pointers, brush, measures, actions) {
    this.studio = studio;
    this.views = views;
    this.pointers = pointers;
    this.brush = brush;
    this.measures = measures;
    this.actions = actions;
    this.areOn.listen((on) => keep("keys", on ? "on" : "off"));
    document.addEventListener("keydown", (event) => {
      if (!event.defaultPrevented && this.#press(event)) event.preventDefault();
    });
    document.addEventListener("keyup", (event) => this.#release(event));
    window.addEventListener("blur", () => {
      studio.erasing.value = studio.panning.value = false;
    });
  }

  /** @param {KeyboardEvent} event @returns {boolean} whether the key did something. */
  #press(event) {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const isAltGraph = event.getModifierState("AltGraph");
    if ((event.ctrlKey || event.metaKey) && !isAltGraph) {
      if (key === "z") event.shiftKey ? this.actions.redo() : this.actions.undo();
      else if (key === "y") this.actions.redo();
      else return false;
      return true;
    }
    if (!this.areOn.value || (event.altKey && !isAltGraph && key !== "Alt")) return false;
    const target = event.target instanceof Element ? event.target : document.body;
    if (target.matches("select, textarea, input:not([type=range], [type=checkbox])")) return false;
    if (target.matches("input[type=range]") && /^(Arrow|Page|Home|End)/.test(key)) return false;
    if (target.matches("button, input, a, summary, [role=tab]") && (key === "Enter" || key === " ")) return false;
    // a button that is disabled while it works loses the focus, also in a dialog
    if (target.closest("dialog, [popover]") || document.querySelector("dialog[open]")) return false;
    // the browser closes it, unless the key is taken
    if (key === "Escape" && document.querySelector(":popover-open")) return false;
    return this.#move(event, key) || this.#choose(event, key) || this.#act(event, key);
  }

  /** @param {KeyboardEvent} event @param {string} key */
  #move(event, key) {
    const view = this.views.active;
    /** @type {Record<string, [number, number]>} */
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const arrow = arrows[key];
    if (arrow && event.shiftKey) view.nudge(...arrow);
    else if (arrow) view.scroll(key === "ArrowUp" || key === "ArrowRight" ? 1 : -1);
    else if (key === "PageUp") view.scroll(10);
    else if (key === "PageDown") view.scroll(-10);
    else return false;
    return true;
  }

  /** @param {KeyboardEvent} event @param {string} key */
  #choose(event, key) {
    const { studio } = this;
    if (event.repeat) return /^[bxvma0-9eo lft]$/.test(key) || key === "Alt";
    /** @type {Record<string, import("../studio.js").Tool>} */
    const tools = { b: "brush", x: "eraser", v: "pointer", m: "ruler", a: "angle" };
    if (tools[key]) studio.take(tools[key]);
    else if (/^[0-9]$/.test(key)) {
      const label = studio.labels.value.find((one) => keyOf(one, studio.labels.value) === key);
      if (label) studio.pick(label.value);
    } else if (key === "e" || key === "Alt") studio.erasing.value = true;
    else if (key === " ") {
      this.#spaceAt = event.timeStamp;
      this.pointers.hasPanned = false;
      studio.panning.value = true;
    } else if (key === "l") studio.labelsShown.value = !studio.labelsShown.value;
    else if (key === "o") studio.outline.value = !studio.outline.value;
    else if (key === "f") this.views.fit();
    else if (key === "t") studio.large.value = studio.large.value === studio.activeView.value ? null : studio.activeView.value;
    else return false;
    return true;
  }

  /** @param {KeyboardEvent} event @param {string} key */
  #act(event, key) {
    const { studio } = this;
    if (key === "z") this.actions.undo();
    else if (key === "y") this.actions.redo();
    else if (key === "n") this.actions.nextPlace();
    else if (key === "r") this.actions.placeRight();
    else if (key === "w") this.actions.placeWrong();
    else if (key === "[" || key === ",") studio.resizeBrush(-1);
    else if (key === "]" || key === ".") studio.resizeBrush(1);
    else if (key === "j" || key === "k") this.views.turnStep(key === "j" ? -1 : 1);
    else if (key === "s") this.actions.shape();
    else if (key === "Delete" || key === "Backspace") {
      // held down, it would go on with the next ones
      if (!event.repeat && (studio.tool.value !== "shape" || !this.actions.removeShape())) this.measures.removeLast();
    } else if (key === "Escape") {
      if (!this.pointers.hands?.drop() && !this.measures.drop()) studio.large.value = null;
    } else if (key === "Enter" && !event.repeat) this.#dab();
    else return false;
    return true;
  }

  /** A stroke of one point at the crosshair; a point of a measurement with its tools. */
  #dab() {
    const { studio } = this;
    const tool = studio.tool.value;
    const mm = studio.crosshair.value;
    if (tool === "ruler" || tool === "angle") this.measures.set(tool, mm);
    else if (tool === "shape") this.pointers.hands?.placeAtCrosshair();
    else if (tool !== "pointer" && this.brush.begin(mm, studio.erases)) this.brush.end();
  }

  /** @param {KeyboardEvent} event */
  #release(event) {
    const { studio } = this;
    if (event.key.toLowerCase() === "e" || event.key === "Alt") {
      if (studio.erasing.value && event.key === "Alt") event.preventDefault();
      studio.erasing.value = false;
    }
    if (event.key === " " && studio.panning.value) {
      studio.panning.value = false;
      if (!this.pointers.hasPanned && event.timeStamp - this.#spaceAt < TAP_MS) studio.swapTools();
    }
  }
}

/**
 * The number key of a structure: 0 of the background, 1 to 9 of the others as they are listed; none beyond.
 * @param {{value: number, role: string}} label
 * @param {readonly {value: number, role: string}[]} labels
 */
export function keyOf(label, labels) {
  if (label.role === "background") return "0";
  const place = labels.filter((one) => one.role !== "background").findIndex((one) => one.value === label.value);
  return place >= 0 && place < 9 ? String(place + 1) : "";
}

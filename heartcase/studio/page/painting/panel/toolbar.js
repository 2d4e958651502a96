/** The bar above: tools, brush size, undo, window, what is shown; theme and language. */

import { runLanguage, runTheme } from "../../shared/looks.js";
import { LARGEST_RADIUS_MM, SMALLEST_RADIUS_MM } from "../studio.js";
import { figure, isWord, language, say, structureName } from "../../shared/words.js";

/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../studio.js").Tool} Tool */
/** @typedef {import("../studio.js").Range} Range */

/** Windows that radiologists use on CT, Hounsfield units. @type {Record<string, Range>} */
const CT_WINDOWS = {
  window_vessels: { low: -100, high: 700 },
  window_soft: { low: -160, high: 240 },
  window_lung: { low: -1350, high: 150 },
  window_bone: { low: -500, high: 1300 },
};
/** MR has no unit: shares of the window that the recipe was opened with. @type {Record<string, [number, number]>} */
const MR_SHARES = { window_dark: [0, 0.5], window_bright: [0.4, 1] };

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/** @param {Studio} studio @param {{undo: () => void, redo: () => void, fit: () => void}} actions */
export function runToolbar(studio, actions) {
  runTools(studio);
  runInHand(studio);
  runSizes(studio);
  runHistory(studio, actions);
  runWindow(studio);
  runLook(studio, actions);
  runTheme();
  runLanguage();
}

/** @param {Studio} studio */
function runTools(studio) {
  for (const button of document.querySelectorAll("button[data-tool]")) {
    const tool = /** @type {Tool} */ (button.getAttribute("data-tool"));
    button.addEventListener("click", () => studio.take(tool));
    const tell = () => {
      const isInHand = studio.erasing.value && studio.tool.value === "brush" ? tool === "eraser" : tool === studio.tool.value;
      button.setAttribute("aria-pressed", String(isInHand));
      /** @type {HTMLButtonElement} */ (button).disabled = (tool === "brush" || tool === "eraser") && !studio.ready.value;
    };
    studio.tool.follow(tell);
    studio.erasing.follow(tell);
    studio.ready.follow(tell);
  }
  studio.tool.follow((tool) => (document.body.dataset.tool = tool));
}

/** What the brush paints stands in the foot: the list of structures is hidden while another tab is shown. @param {Studio} studio */
function runInHand(studio) {
  const shown = find("in-hand");
  const chip = /** @type {HTMLElement} */ (shown.querySelector(".chip"));
  const name = /** @type {HTMLElement} */ (shown.querySelector(".name"));
  const tell = () => {
    const label = studio.pickedLabel;
    shown.hidden = label === null || studio.tool.value !== "brush" || studio.erases;
    if (label === null) return;
    chip.style.background = label.colour;
    name.textContent = name.title = say("in_hand", { name: structureName(label.name) });
  };
  for (const signal of [studio.labels, studio.picked, studio.tool, studio.erasing, language]) {
    /** @type {import("../../shared/signal.js").Signal<any>} */ (signal).follow(tell);
  }
}

/** @param {Studio} studio */
function runSizes(studio) {
  const slider = /** @type {HTMLInputElement} */ (find("radius"));
  // Even steps of a slider are even factors of the radius.
  const span = Math.log(LARGEST_RADIUS_MM / SMALLEST_RADIUS_MM);
  slider.addEventListener("input", () => {
    const radius = SMALLEST_RADIUS_MM * Math.exp((Number(slider.value) / 100) * span);
    studio.radiusMm.value = Math.round(radius * 10) / 10;
  });
  const tell = () => {
    const radius = studio.radiusMm.value;
    if (document.activeElement !== slider) slider.value = String(Math.round((Math.log(radius / SMALLEST_RADIUS_MM) / span) * 100));
    slider.setAttribute("aria-valuetext", `${figure(radius, 1)} mm`);
    find("radius-words").textContent = `${figure(radius, 1)} mm`;
  };
  studio.radiusMm.follow(tell);
  language.listen(tell);
}

/** @param {Studio} studio @param {{undo: () => void, redo: () => void}} actions */
function runHistory(studio, actions) {
  for (const name of /** @type {const} */ (["undo", "redo"])) {
    const button = /** @type {HTMLButtonElement} */ (find(name));
    const count = name === "undo" ? studio.undoCount : studio.redoCount;
    const kind = name === "undo" ? studio.undoKind : studio.redoKind;
    button.addEventListener("click", () => actions[name]());
    const tell = () => {
      button.disabled = !studio.ready.value || count.value === 0;
      /** @type {HTMLElement} */ (button.querySelector(".count")).textContent = String(count.value);
      const isWall = kind.value.endsWith(".wall_thickness_mm");
      const word = isWall ? "act_walls" : `act_${/^\w+/.exec(kind.value)?.[0]}`;
      const what = count.value === 0 ? "" : `, ${isWord(word) ? say(word) : kind.value}`;
      button.title = `${say(name)}${what}`;
      button.setAttribute("aria-label", `${say(name)}${what}: ${count.value}`);
    };
    language.listen(tell);
    count.follow(tell);
    kind.listen(tell);
    studio.ready.follow(tell);
  }
}

/** @param {Studio} studio */
function runWindow(studio) {
  const select = /** @type {HTMLSelectElement} */ (find("window"));
  const fill = () => {
    const names = ["window_first", "window_all", ...Object.keys(studio.modality.value === "CT" ? CT_WINDOWS : MR_SHARES)];
    const options = ["window_choose", ...names].map((name) => {
      const option = document.createElement("option");
      option.value = name;
      option.textContent = say(/** @type {import("../../shared/words.js").Word} */ (name));
      return option;
    });
    select.replaceChildren(...options);
  };
  select.addEventListener("change", () => {
    const name = select.value;
    if (name === "window_first") studio.window.value = { ...studio.firstWindow.value };
    else if (name === "window_all") studio.window.value = { ...studio.range.value };
    else if (CT_WINDOWS[name]) studio.window.value = { ...CT_WINDOWS[name] };
    else if (MR_SHARES[name]) {
      const { low, high } = studio.firstWindow.value;
      const [from, to] = MR_SHARES[name].map((share) => low + share * (high - low));
      studio.window.value = { low: from, high: to };
    }
    select.value = "window_choose";
  });
  studio.modality.follow(fill);
  language.listen(fill);
  const fields = /** @type {const} */ (["level", "width"]);
  const inputs = fields.map((name) => /** @type {HTMLInputElement} */ (find(`window-${name}`)));
  const tell = () => {
    const { low, high } = studio.window.value;
    const values = [(low + high) / 2, high - low];
    inputs.forEach((input, n) => {
      if (document.activeElement !== input) input.value = String(Math.round(values[n]));
    });
  };
  for (const input of inputs) {
    input.addEventListener("change", () => {
      const [level, width] = inputs.map((one) => Number(one.value));
      if (Number.isFinite(level) && width > 0) studio.window.value = { low: level - width / 2, high: level + width / 2 };
      else tell();
    });
    input.addEventListener("blur", tell);
  }
  studio.window.follow(tell);
}

/** @param {Studio} studio @param {{fit: () => void}} actions */
function runLook(studio, actions) {
  const opacity = /** @type {HTMLInputElement} */ (find("opacity"));
  opacity.addEventListener("input", () => (studio.opacity.value = Number(opacity.value) / 100));
  studio.opacity.follow((value) => (opacity.value = String(Math.round(value * 100))));
  for (const [id, signal] of /** @type {const} */ ([["outline", studio.outline], ["labels-shown", studio.labelsShown]])) {
    const box = /** @type {HTMLInputElement} */ (find(id));
    box.addEventListener("change", () => (signal.value = box.checked));
    signal.follow((value) => (box.checked = value));
  }
  find("fit").addEventListener("click", () => actions.fit());
}

/** The case's name in the bar: a click lets it be typed anew. */

import { language, say } from "../../shared/words.js";

/** What a name may be made of, as the recipe's schema says. */
export const NAME_PATTERN = "[A-Za-z0-9][A-Za-z0-9 _.\\(\\)+\\-]*";

/**
 * @param {import("../studio.js").Studio} studio
 * @param {import("../../shaping/shaping.js").Shaping} shaping
 */
export function runNaming(studio, shaping) {
  const shown = /** @type {HTMLButtonElement} */ (document.getElementById("case-name"));
  const field = /** @type {HTMLInputElement} */ (document.getElementById("case-rename"));
  field.pattern = NAME_PATTERN;
  let name = "";
  const show = () => {
    if (name) shown.textContent = name;
    shown.title = name ? say("rename", { name }) : "";
  };
  shaping.shape.listen((shape) => {
    name = shape?.name ?? name;
    show();
  });
  language.listen(show);
  /** @param {boolean} isOpen */
  const swap = (isOpen) => {
    shown.hidden = isOpen;
    field.hidden = !isOpen;
  };
  shown.addEventListener("click", () => {
    if (!studio.ready.value) return;
    field.value = name;
    swap(true);
    field.select();
    field.focus();
  });
  const end = () => {
    if (field.hidden) return;
    const wanted = field.value.trim();
    swap(false);
    if (wanted && wanted !== name) void shaping.set(["name"], wanted);
  };
  field.addEventListener("keydown", (event) => {
    if (event.key === "Escape") field.value = name;
    if (event.key !== "Enter" && event.key !== "Escape") return;
    event.preventDefault();
    event.stopPropagation();
    end();
    shown.focus();
  });
  field.addEventListener("blur", end);
}

/** Structures that are added to the recipe's list, and taken out of it again. */

import { language, say, structureName } from "../../shared/words.js";
import { element } from "../../shared/elements.js";

/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../../shaping/shaping.js").Shaping} Shaping */
/** @typedef {import("../../shaping/shaping.js").NewLabel} NewLabel */

/** Colours of structures that the vocabulary lacks, one after the other: told apart from those of the heart and from each other. */
const COLOURS = ["#2fbf71", "#e05ab8", "#00a6a6", "#b8a200", "#8c6bff", "#d97a00", "#5aa9e6", "#a35d3d"];
/** Cavities have walls. */
const CAVITIES = new Set(["blood", "vessel_lumen"]);

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
/** @param {string} id */
const input = (id) => /** @type {HTMLInputElement} */ (document.getElementById(id));
/** @param {string} id */
const select = (id) => /** @type {HTMLSelectElement} */ (document.getElementById(id));

/** @param {Studio} studio @param {Shaping} shaping */
export function runNewStructure(studio, shaping) {
  const part = /** @type {HTMLDetailsElement} */ (find("new-structure"));
  const form = /** @type {HTMLFormElement} */ (find("new-structure-form"));
  const [which, role] = [select("new-structure-which"), select("new-structure-role")];
  const [name, colour, wall] = [input("new-structure-name"), input("new-structure-colour"), input("new-structure-wall")];
  const remove = /** @type {HTMLButtonElement} */ (find("structure-remove"));
  let isAdding = false;

  /** Those of the vocabulary that the recipe lacks. @returns {readonly NewLabel[]} */
  const offered = () => {
    const there = new Set(studio.labels.value.map((label) => label.name.toLowerCase()));
    return (shaping.facts.value?.new_labels ?? []).filter((one) => !there.has(one.name.toLowerCase()));
  };

  const fill = () => {
    const chosen = which.value;
    which.replaceChildren(...offered().map((one) => option(one.name, structureName(one.name))), option("", say("new_structure_other")));
    which.value = [...which.options].some((one) => one.value === chosen) ? chosen : (which.options[0]?.value ?? "");
    const roles = shaping.facts.value?.roles ?? [];
    const chosenRole = role.value || roles[0];
    role.replaceChildren(...roles.map((one) => option(one, say(/** @type {import("../../shared/words.js").Word} */ (`role_${one}`)))));
    role.value = chosenRole ?? "";
    propose();
  };

  /** What is usual for the structure that is chosen. */
  const propose = () => {
    const known = offered().find((one) => one.name === which.value);
    const taken = new Set(studio.labels.value.map((label) => label.colour));
    colour.value = known?.colour ?? COLOURS.find((one) => !taken.has(one)) ?? COLOURS[0];
    if (known) role.value = known.role;
    name.value = "";
    proposeWall();
  };

  const proposeWall = () => {
    const all = shaping.facts.value?.new_labels ?? [];
    // the last one of its kind has a wall that is grown
    const usual = all.find((one) => one.name === which.value) ?? all.filter((one) => one.role === role.value).at(-1);
    wall.value = String(usual?.wall_thickness_mm ?? 0);
    show();
  };

  const show = () => {
    const isOther = which.value === "";
    find("new-structure-own").hidden = !isOther;
    name.required = isOther;
    find("new-structure-wall-part").hidden = !CAVITIES.has(role.value);
  };

  const tellRemove = () => {
    const label = studio.pickedLabel;
    remove.hidden = label === null || label.role === "background";
    if (label) remove.textContent = say("structure_remove", { name: structureName(label.name) });
    remove.disabled = !studio.ready.value;
  };

  which.addEventListener("change", propose);
  role.addEventListener("change", proposeWall);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    // the second click of a double one
    if (isAdding) return;
    const entry = { name: which.value || name.value.trim(), role: role.value, colour: colour.value };
    const isCavity = CAVITIES.has(role.value) && wall.valueAsNumber > 0;
    void add({ ...entry, wall_thickness_mm: isCavity ? wall.valueAsNumber : null });
  });
  remove.addEventListener("click", () => {
    const label = studio.pickedLabel;
    // closed, so that a further click does not go on with the next one
    if (label) void shaping.removeLabel(label.name).then((answer) => answer !== null && (part.open = false));
  });

  /** @param {NewLabel} entry */
  async function add(entry) {
    const known = offered().find((one) => one.name === entry.name);
    // the structure's own colour need not be stated
    const stated = known?.colour === entry.colour ? { ...entry, colour: null } : entry;
    isAdding = true;
    const isAdded = await shaping.addLabel(stated);
    isAdding = false;
    if (!isAdded) return;
    part.open = false;
    const added = studio.labels.value.find((label) => label.name === entry.name);
    if (added) studio.pick(added.value);
    /** @type {HTMLElement | null} */ (document.querySelector(`#structures [data-value="${added?.value}"] .pick`))?.focus();
  }

  shaping.facts.follow(fill);
  studio.labels.listen(fill);
  language.listen(fill);
  studio.labels.listen(tellRemove);
  studio.picked.listen(tellRemove);
  studio.ready.listen(tellRemove);
  language.listen(tellRemove);
  tellRemove();
}

/** @param {string} value @param {string} text */
function option(value, text) {
  const made = element("option", "", text);
  made.value = value;
  return made;
}

/** A form of a line or of settings, built from what the recipe's schema allows. */

import { figure, isWord, say, structureName } from "../shared/words.js";
import { element } from "../shared/elements.js";

/** @typedef {import("./shaping.js").Entry} Entry */
/** @typedef {import("./shaping.js").Field} Field */
/** @typedef {import("./shaping.js").Structure} Structure */
/** @typedef {(name: string, value: any) => void} OnChange a value of null leaves the setting out */

const AXES = /** @type {const} */ (["x", "y", "z"]);
let nextId = 1;

/** What a setting is called. @param {string} name */
export function fieldWord(name) {
  const key = `field_${name}`;
  return isWord(key) ? say(key) : name;
}

/** What a kind of line is called. @param {string} kind */
export function kindWord(kind) {
  const key = `kind_${kind}`;
  return isWord(key) ? say(key) : kind;
}

/** What one of a setting's values is called. @param {string} value */
export function choiceWord(value) {
  const key = `choice_${value.replaceAll(" ", "_")}`;
  return isWord(key) ? say(key) : value;
}

/**
 * Rows of a form, one for each field.
 * @param {readonly Field[]} fields
 * @param {Entry} entry
 * @param {readonly Structure[]} structures
 * @param {OnChange} onChange
 * @returns {HTMLElement[]}
 */
export function formRows(fields, entry, structures, onChange) {
  return fields.map((field) => {
    const row = element("div", "field");
    const id = `field-${nextId++}`;
    const label = element("label", "", fieldWord(field.name));
    label.htmlFor = id;
    label.title = field.meaning;
    const input = inputOf(field, entry[field.name], structures, (value) => onChange(field.name, value));
    const first = input.matches("input, select, output") ? input : /** @type {HTMLElement} */ (input.querySelector("input, select"));
    if (first) first.id = id;
    row.append(label, input);
    if (field.unit && field.type !== "point" && field.type !== "points") row.append(element("span", "unit", field.unit === "kg/m3" ? "kg/m³" : field.unit));
    return row;
  });
}

/** @param {Field} field @param {any} value @param {readonly Structure[]} structures @param {(value: any) => void} onChange @returns {HTMLElement} */
function inputOf(field, value, structures, onChange) {
  if (field.type === "boolean") {
    const box = element("input");
    box.type = "checkbox";
    box.checked = value ?? field.default ?? false;
    box.addEventListener("change", () => onChange(box.checked === (field.default ?? false) ? null : box.checked));
    return box;
  }
  if (field.type === "choice") return selectOf(field.choices ?? [], value ?? field.default, choiceWord, onChange, false);
  if (field.type === "structure") {
    const names = structures.map(({ name }) => name);
    const shown = value ?? field.default ?? "";
    return selectOf(names.includes(shown) || shown === "" ? names : [...names, shown], shown, structureName, onChange, !field.needed);
  }
  if (field.type === "structures") return structuresOf(structures, value ?? [], onChange);
  if (field.type === "point" || field.type === "direction") return vectorOf(field, value ?? null, onChange);
  if (field.type === "points") return element("output", "figure", say("shape_points", { count: value?.length ?? 0 }));
  if (field.type === "array") return element("output", "figure", (value ?? []).map((/** @type {number} */ one) => figure(one, 1)).join("; "));
  const input = element("input");
  const isNumber = field.type === "number" || field.type === "integer";
  input.type = isNumber ? "number" : "text";
  if (isNumber) {
    input.step = field.type === "integer" ? "1" : "any";
    if (field.minimum !== undefined) input.min = String(field.minimum);
    if (field.exclusiveMinimum !== undefined) input.min = String(field.exclusiveMinimum);
    if (field.maximum !== undefined) input.max = String(field.maximum);
  } else input.maxLength = field.maxLength ?? 64;
  input.value = value === undefined || value === null ? "" : String(value);
  if (field.default !== undefined) input.placeholder = String(field.default);
  input.required = field.needed;
  input.addEventListener("change", () => {
    const text = input.value.trim();
    onChange(text === "" ? null : isNumber ? Number(text) : text);
  });
  return input;
}

/** @param {readonly string[]} values @param {string} chosen @param {(value: string) => string} word @param {(value: any) => void} onChange @param {boolean} isOptional */
function selectOf(values, chosen, word, onChange, isOptional) {
  const select = element("select");
  if (isOptional || !values.includes(chosen)) {
    const none = element("option", "", isOptional ? say("shape_any") : say("shape_choose"));
    none.value = "";
    select.append(none);
  }
  for (const value of values) {
    const option = element("option", "", word(value));
    option.value = value;
    select.append(option);
  }
  select.value = values.includes(chosen) ? chosen : "";
  select.addEventListener("change", () => onChange(select.value === "" ? null : select.value));
  return select;
}

/** @param {readonly Structure[]} structures @param {readonly string[]} chosen @param {(value: any) => void} onChange */
function structuresOf(structures, chosen, onChange) {
  const select = element("select");
  select.multiple = true;
  select.size = 4;
  for (const { name } of structures) {
    const option = element("option", "", structureName(name));
    option.value = name;
    option.selected = chosen.includes(name);
    select.append(option);
  }
  select.addEventListener("change", () => {
    const names = [...select.selectedOptions].map((one) => one.value);
    onChange(names.length > 0 ? names : null);
  });
  return select;
}

/** @param {Field} field @param {readonly number[] | null} value @param {(value: any) => void} onChange */
function vectorOf(field, value, onChange) {
  const group = element("span", "vector");
  group.setAttribute("role", "group");
  group.setAttribute("aria-label", fieldWord(field.name));
  const inputs = AXES.map((axis, n) => {
    const input = element("input");
    input.type = "number";
    input.step = "any";
    input.value = value ? String(value[n]) : "";
    input.setAttribute("aria-label", `${fieldWord(field.name)} ${axis}`);
    input.title = axis;
    return input;
  });
  for (const input of inputs) {
    input.addEventListener("change", () => {
      const texts = inputs.map((one) => one.value.trim());
      if (texts.every((text) => text === "")) onChange(null);
      else if (texts.every((text) => text !== "")) onChange(texts.map(Number));
    });
  }
  group.append(...inputs);
  return group;
}

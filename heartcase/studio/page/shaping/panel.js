/** The tab Shape: what can be placed, the lines that the recipe has, walls, materials and settings. */

import { element, icon } from "../shared/elements.js";
import { figure, isWord, language, say, structureName } from "../shared/words.js";
import { formRows, kindWord } from "./form.js";
import { short } from "../building/results.js";
import { lumenOf } from "./lumen.js";
import { discOf, isSame, kindOf, placeOf } from "./shaping.js";

/** @typedef {import("../painting/studio.js").Studio} Studio */
/** @typedef {import("../painting/pictures/views.js").Views} Views */
/** @typedef {import("./hands.js").Hands} Hands */
/** @typedef {import("./shaping.js").Entry} Entry */
/** @typedef {import("./shaping.js").Kind} Kind */
/** @typedef {import("./shaping.js").Line} Line */
/** @typedef {import("./shaping.js").List} List */
/** @typedef {import("./shaping.js").Shaping} Shaping */

/** Sections of the tab, with what is placed in each. @type {readonly {word: "shape_ends" | "shape_edits" | "shape_landmarks" | "shape_pins", list: List, kinds: readonly string[]}[]} */
const SECTIONS = [
  { word: "shape_ends", list: "ends", kinds: ["ends"] },
  { word: "shape_edits", list: "edits", kinds: ["septal_defect", "close_defect", "add", "remove", "smooth", "fill", "keep_largest", "remove_islands"] },
  { word: "shape_landmarks", list: "landmarks", kinds: ["point", "ring", "polyline"] },
  { word: "shape_pins", list: "pins", kinds: ["pins"] },
];
/** Lines that are made at no place. */
const PLACELESS = new Set(["keep_largest", "remove_islands"]);

export class ShapePanel {
  /**
   * @param {HTMLElement} body
   * @param {Studio} studio
   * @param {Views} views
   * @param {Shaping} shaping
   * @param {Hands} hands
   */
  constructor(body, studio, views, shaping, hands) {
    this.body = body;
    this.studio = studio;
    this.views = views;
    this.shaping = shaping;
    this.hands = hands;
    /** Which sections are open: they stay so when the recipe changes. @type {Set<string>} */
    this.open = new Set(["shape_ends", "shape_edits"]);
    this.hint = element("p", "hint");
    this.hint.setAttribute("role", "status");
    this.lists = element("div");
    body.replaceChildren(this.hint, this.lists);
    for (const signal of [shaping.shape, shaping.facts, shaping.selected, shaping.found, studio.ready, shaping.isOpen]) {
      /** @type {import("../shared/signal.js").Signal<any>} */ (signal).listen(() => this.#build());
    }
    shaping.draft.listen(() => this.tellLumens());
    for (const signal of [shaping.placing, studio.picked, studio.radiusMm]) {
      /** @type {import("../shared/signal.js").Signal<any>} */ (signal).listen(() => this.#tellPlacing());
    }
    language.listen(() => {
      this.#build();
      this.#tellPlacing();
    });
    this.#tellPlacing();
  }

  /** What a click does now. */
  #tellPlacing() {
    const { placing } = this.shaping;
    const kind = placing.value?.kind ?? null;
    const key = `place_${kind}`;
    const values = { label: structureName(this.studio.pickedLabel?.name ?? ""), mm: figure(this.studio.radiusMm.value, 1) };
    this.hint.textContent = kind !== null && isWord(key) ? say(key, values) : say("shape_hint");
    this.hint.classList.toggle("placing", kind !== null);
    for (const button of /** @type {Iterable<HTMLElement>} */ (this.lists.querySelectorAll("[data-place]"))) {
      button.setAttribute("aria-pressed", String(button.dataset.place === kind));
    }
  }

  #build() {
    const { shape, facts, isOpen } = this.shaping;
    if (!isOpen.value || shape.value === null || facts.value === null) return;
    // What has the focus keeps it: forms are built anew with every change.
    const focused = /** @type {HTMLElement | null} */ (document.activeElement);
    const at = focused && this.lists.contains(focused) ? [...this.lists.querySelectorAll(FOCUSABLE)].indexOf(focused) : -1;
    this.lists.replaceChildren(
      ...(shape.value.is_locked ? [element("p", "", say("shape_locked"))] : []),
      ...SECTIONS.map(({ word, list, kinds }) => this.#section(word, [this.#placeButtons(list, kinds), ...(list === "ends" ? this.#found() : []), this.#lines(list)])),
      this.#section("shape_walls", [this.#walls(), ...["walls.thickness", "walls.septum", "walls.contact"].map((list) => this.#lines(/** @type {List} */ (list))), ...this.#settings("walls")]),
      this.#section("shape_materials", this.#materials()),
      this.#section("shape_model", [...this.#settings("grid"), ...this.#settings("surface")]),
    );
    this.#tellPlacing();
    if (at >= 0) /** @type {HTMLElement | undefined} */ (this.lists.querySelectorAll(FOCUSABLE)[at])?.focus({ preventScroll: true });
  }

  /** @param {import("../shared/words.js").Word} word @param {HTMLElement[]} parts */
  #section(word, parts) {
    const section = element("details", "section");
    section.open = this.open.has(word);
    section.dataset.section = word;
    section.addEventListener("toggle", () => (section.open ? this.open.add(word) : this.open.delete(word)));
    section.append(element("summary", "", say(word)), ...parts);
    return section;
  }

  /** @param {List} list @param {readonly string[]} kinds */
  #placeButtons(list, kinds) {
    const row = element("div", "place-buttons");
    row.setAttribute("role", "group");
    for (const kind of kinds) {
      const button = element("button", "", kindWord(kind));
      button.type = "button";
      button.disabled = !this.studio.ready.value;
      if (PLACELESS.has(kind)) {
        button.addEventListener("click", () => void this.shaping.add(list, [this.#placeless(kind)]));
      } else {
        button.dataset.place = kind;
        button.addEventListener("click", () => this.arm({ list, kind }));
      }
      row.append(button);
    }
    if (list === "ends") {
      const find = element("button", "find-ends", say("shape_find_ends"));
      find.type = "button";
      find.disabled = !this.studio.ready.value;
      find.addEventListener("click", () => void this.#findEnds(find));
      row.append(find);
    }
    return row;
  }

  /** A click places a line of this kind, or no longer. @param {Kind} kind */
  arm(kind) {
    const { placing } = this.shaping;
    placing.value = placing.value?.kind === kind.kind ? null : kind;
    this.studio.take("shape");
  }

  /** @param {string} kind @returns {Entry} */
  #placeless(kind) {
    return kind === "keep_largest" ? { kind, label: this.studio.pickedLabel?.name ?? "" } : { kind };
  }

  /** @param {HTMLButtonElement} button */
  async #findEnds(button) {
    button.disabled = true;
    button.textContent = say("looking");
    await this.shaping.findEnds();
    button.disabled = false;
    button.textContent = say("shape_find_ends");
  }

  /** Ends that were found: each is taken by a click. @returns {HTMLElement[]} */
  #found() {
    const { found } = this.shaping;
    if (found.value === null) return [];
    const ends = found.value;
    if (ends.length === 0) return [element("p", "found", say("shape_found_none"))];
    const list = element("ul", "found");
    for (const end of ends) {
      const row = element("li", "line");
      const go = element("button", "go", `${structureName(end.label)}: ${this.#endWords(end)}`);
      go.type = "button";
      go.addEventListener("click", () => this.views.lookAt(end.position_mm));
      const take = element("button", "", say("shape_take"));
      take.type = "button";
      take.addEventListener("click", () => void this.#take([end]));
      row.append(go, take);
      list.append(row);
    }
    const all = element("button", "main take-all", say("shape_take_all", { count: ends.length }));
    all.type = "button";
    all.addEventListener("click", () => void this.#take(ends));
    return [element("p", "found", say("shape_found", { count: ends.length })), list, all];
  }

  /** @param {readonly Entry[]} ends */
  async #take(ends) {
    const { found } = this.shaping;
    const left = (found.value ?? []).filter((one) => !ends.includes(one));
    if (await this.shaping.add("ends", [...ends])) found.value = left.length > 0 ? left : null;
  }

  /** @param {List} list */
  #lines(list) {
    const rows = element("ul", "lines");
    const { shape, selected } = this.shaping;
    shape.value?.lines[list].forEach((entry, n) => {
      const line = { list, number: n + 1 };
      const isPicked = isSame(line, selected.value);
      const row = element("li", isPicked ? "line picked" : "line");
      row.dataset.line = `${list} ${line.number}`;
      const go = element("button", "go");
      go.type = "button";
      go.setAttribute("aria-expanded", String(isPicked));
      const measure = element("span", "figure", measureOf(entry));
      if (list === "ends") {
        measure.dataset.end = String(line.number);
        measure.textContent = this.#endWords(entry);
      }
      go.append(element("span", "line-name", lineName(list, entry, line.number)), measure);
      if (entry.enabled === false) go.append(element("span", "off", say("shape_off")));
      go.addEventListener("click", () => this.#choose(line, entry));
      const remove = element("button", "remove");
      remove.type = "button";
      remove.setAttribute("aria-label", say("shape_remove", { name: lineName(list, entry, line.number) }));
      remove.title = say("shape_remove", { name: "" }).trim();
      remove.append(icon("remove"));
      onOneClick(remove, () => void this.shaping.remove(line, entry));
      row.append(go, remove);
      if (isPicked) row.append(this.#form(line, entry));
      rows.append(row);
    });
    return rows;
  }

  /** Labels or a disc changed: vessels may be wider or narrower at their ends. */
  tellLumens() {
    if (!this.shaping.isOpen.value) return;
    const { shape, draft } = this.shaping;
    for (const one of /** @type {Iterable<HTMLElement>} */ (this.lists.querySelectorAll("[data-end]"))) {
      const number = Number(one.dataset.end);
      const dragged = draft.value?.line.list === "ends" && draft.value.line.number === number ? draft.value.entry : undefined;
      const entry = dragged ?? shape.value?.lines.ends[number - 1];
      const words = entry ? this.#endWords(entry) : "";
      if (one.textContent !== words) one.textContent = words;
    }
  }

  /** How wide the vessel is at its end, and the disc. @param {Entry} entry */
  #endWords(entry) {
    const disc = discOf("ends", entry);
    const lattice = this.studio.lattice.value;
    const value = this.studio.labels.value.find(({ name }) => name === entry.label)?.value;
    const disc_mm = figure(2 * entry.radius_mm, 1);
    if (disc === null || lattice === null || value === undefined) return say("end_disc", { disc: disc_mm });
    const isInside = (/** @type {import("../shared/geometry.js").Vector} */ mm) => {
      const voxel = lattice.voxelAt(mm);
      return voxel !== null && this.hands.labelValueAt?.(voxel) === value;
    };
    const found = lumenOf(disc, isInside, lattice.sliceStep([0, 0, 1]) / 4);
    if (found === null) return say("end_beside", { disc: disc_mm });
    return say(found.isCut ? "end_narrow" : "end_lumen", { lumen: figure(found.mm, 1), disc: disc_mm });
  }

  /** @param {Line} line @param {Entry} entry */
  #choose(line, entry) {
    const { selected } = this.shaping;
    const place = placeOf(entry);
    if (isSame(line, selected.value)) selected.value = null;
    else {
      selected.value = line;
      if (place) this.views.lookAt(place);
    }
  }

  /** @param {Line} line @param {Entry} entry */
  #form(line, entry) {
    const form = element("div", "form");
    const { facts, shape } = this.shaping;
    const kinds = facts.value?.lines[line.list] ?? {};
    const fields = kinds[kindOf(line.list, entry)] ?? kinds[""] ?? [];
    const isRound = entry.shape === undefined;
    const shown = fields.filter(({ name }) => !isRound || (name !== "width_mm" && name !== "long_axis"));
    form.append(...formRows(shown, entry, shape.value?.structures ?? [], (name, value) => void this.shaping.change(line, entry, changed(entry, name, value))));
    const buttons = element("div", "place-buttons");
    /** @type {[import("../shared/words.js").Word, () => void][]} */
    const acts = [];
    if (placeOf(entry)) acts.push(["shape_to_crosshair", () => this.hands.moveToCrosshair()]);
    if (entry.axis) acts.push(["shape_flip", () => this.hands.flip()]);
    if (entry.kind === "septal_defect") acts.push(["shape_close_this", () => void this.shaping.add("edits", [closing(entry)])]);
    for (const [word, act] of acts) {
      const button = element("button", "", say(word));
      button.type = "button";
      button.addEventListener("click", act);
      buttons.append(button);
    }
    form.append(buttons);
    return form;
  }

  #walls() {
    const table = element("div", "walls");
    const { shape, facts } = this.shaping;
    for (const { label, term, wall_thickness_mm, has_table } of shape.value?.walls ?? []) {
      const usual = term === null ? undefined : facts.value?.usual_wall_mm[term];
      const field = { name: "wall_thickness_mm", type: "number", needed: false, unit: "mm", minimum: 0, maximum: 50, default: 0, meaning: say("shape_wall_meaning") };
      const [row] = formRows([field], { wall_thickness_mm }, [], (_, value) => void this.shaping.set(["labels", label, "wall_thickness_mm"], value ?? 0));
      row.dataset.wall = label;
      /** @type {HTMLElement} */ (row.querySelector("label")).textContent = structureName(label);
      const note = has_table ? say("shape_wall_table") : usual !== undefined && usual > 0 && usual !== wall_thickness_mm ? say("shape_usual", { mm: figure(usual, 1) }) : "";
      row.append(element("span", "note", note));
      table.append(row);
    }
    return table;
  }

  /** @returns {HTMLElement[]} */
  #materials() {
    const { shape, facts } = this.shaping;
    if (shape.value === null || facts.value === null) return [];
    const { materials, structures } = shape.value;
    const fields = facts.value.settings.materials;
    const parts = [element("h4", "", say("shape_all_tissue")), ...this.#settings("materials"), ...this.#basis(shape.value.settings.materials.material)];
    for (const [name, entry] of Object.entries(materials)) {
      const head = element("div", "line");
      const remove = element("button", "remove");
      remove.type = "button";
      remove.setAttribute("aria-label", say("shape_remove", { name: structureName(name) }));
      remove.append(icon("remove"));
      onOneClick(remove, () => void this.shaping.set(["materials", "labels", name], null));
      head.append(element("h4", "", structureName(name)), remove);
      const usual = Object.fromEntries(fields.map((one) => [one.name, one.default ?? null]));
      parts.push(head, ...formRows(fields, { ...usual, ...entry }, [], (key, value) => {
        void this.shaping.set(["materials", "labels", name], constants(entry, usual, key, value));
      }), ...this.#basis(entry.material));
    }
    const select = element("select", "add-material");
    select.setAttribute("aria-label", say("shape_add_material"));
    select.append(element("option", "", say("shape_add_material")));
    const isTissue = (/** @type {string} */ role) => role === "myocardium" || role === "wall" || role === "device";
    for (const { name, role } of structures) if (isTissue(role) && !(name in materials)) {
      const option = element("option", "", structureName(name));
      option.value = name;
      select.append(option);
    }
    select.addEventListener("change", () => {
      const start = Object.fromEntries(fields.map((one) => [one.name, shape.value?.settings.materials[one.name] ?? one.default]));
      if (select.selectedIndex > 0) void this.shaping.set(["materials", "labels", select.value], start);
    });
    return [...parts, select];
  }

  /** What a named material rests on: no number of it is measured. @param {string | undefined} name */
  #basis(name) {
    const known = name === undefined ? undefined : this.shaping.facts.value?.materials[name];
    return known ? [element("p", "note", say("material_basis", { ratio: figure(known.ratio, 1) }))] : [];
  }

  /** @param {string} table @returns {HTMLElement[]} */
  #settings(table) {
    const { shape, facts } = this.shaping;
    const rows = formRows(facts.value?.settings[table] ?? [], shape.value?.settings[table] ?? {}, [], (name, value) => void this.shaping.set([table, name], value));
    rows.forEach((row, n) => (row.dataset.setting = `${table}.${facts.value?.settings[table][n].name}`));
    return rows;
  }
}

/** What a double click does once: its second click may meet what came in the place of the first. @param {HTMLElement} button @param {() => void} act */
function onOneClick(button, act) {
  button.addEventListener("click", ({ detail }) => {
    if (detail < 2) act();
  });
}

const FOCUSABLE = "button, input, select, summary";

/** @param {Entry} entry @param {string} name @param {any} value null leaves it out @returns {Entry} */
function changed(entry, name, value) {
  const next = { ...entry, [name]: value };
  if (value === null) delete next[name];
  if (name === "shape" && (value === null || value === "circular")) {
    for (const key of ["shape", "width_mm", "long_axis"]) delete next[key];
  } else if (name === "shape") {
    next.width_mm ??= Number((entry.diameter_mm / 2).toFixed(1));
    next.long_axis ??= besides(entry.axis);
  }
  return next;
}

/**
 * What a label's table of constants states after one of them was changed: never nothing, or there is no table.
 * @param {Entry} entry what it states @param {Entry} usual what holds where nothing is stated: no material, but numbers
 * @param {string} key @param {any} value null leaves it out @returns {Entry}
 */
export function constants(entry, usual, key, value) {
  // a material states its numbers itself
  if (key === "material" && value !== null) return { material: value };
  const next = changed(entry, key, value);
  return Object.keys(next).length > 0 ? next : usual;
}

/** A direction across another: the patient's vertical as far as it goes. @param {readonly number[]} axis */
function besides([x, y, z]) {
  return Math.hypot(x, y) > 0.1 * Math.abs(z) ? [0, 0, 1] : [0, 1, 0];
}

/** What closes a defect: a patch a little larger. @param {Entry} defect @returns {Entry} */
function closing({ position_mm, diameter_mm, axis, shape, width_mm, long_axis }) {
  const oval = shape === undefined ? {} : { shape, width_mm: Number((width_mm + 2).toFixed(1)), long_axis };
  return { kind: "close_defect", position_mm, diameter_mm: Number((diameter_mm + 2).toFixed(1)), axis, ...oval };
}

/** @param {List} list @param {Entry} entry @param {number} number */
function lineName(list, entry, number) {
  const kind = list === "landmarks" || list === "ends" ? "" : kindWord(kindOf(list, entry));
  const what = entry.name ?? (entry.label ? structureName(entry.label) : undefined) ?? (entry.between ? betweenWords(list, entry) : kind ? "" : String(number));
  return [kind, what].filter(Boolean).join(": ") || `${number}`;
}

/** @param {List} list @param {Entry} entry */
function betweenWords(list, entry) {
  const pair = entry.between.map(short).join(" – ");
  return list === "walls.contact" ? say(entry.is_open ? "contact_open" : "contact_wall", { pair }) : say("septum_between", { pair });
}

/** How large it is. @param {Entry} entry */
function measureOf(entry) {
  const diameter = entry.diameter_mm ?? (entry.radius_mm === undefined ? undefined : 2 * entry.radius_mm);
  return diameter === undefined ? "" : `∅ ${figure(diameter, 1)} mm`;
}

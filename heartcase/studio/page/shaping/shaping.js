/** What the recipe says beside its strokes, and what the page asks to change of it. */

import { Signal } from "../shared/signal.js";
import { rounded } from "./discs.js";

/** @typedef {import("../shared/geometry.js").Vector} Vector */
/** @typedef {import("./discs.js").Disc} Disc */
/** @typedef {"ends" | "edits" | "landmarks" | "pins" | "walls.thickness" | "walls.septum" | "walls.contact"} List */
/** @typedef {Record<string, any>} Entry a line of the recipe, as it stands there */
/** @typedef {{name: string, type: string, needed: boolean, unit?: string, minimum?: number, exclusiveMinimum?: number, maximum?: number,
 *   maxLength?: number, choices?: string[], default?: any, meaning: string}} Field */
/** @typedef {{lines: Record<List, Record<string, Field[]>>, settings: Record<string, Field[]>, usual_wall_mm: Record<string, number>, new_labels: NewLabel[], roles: string[], materials: Record<string, {ratio: number, basis: string}>}} Facts */
/** @typedef {{name: string, role: string, colour: string | null, wall_thickness_mm: number | null}} NewLabel null where it is the usual one */
/** @typedef {{label: string, term: string | null, wall_thickness_mm: number, has_table: boolean}} Wall */
/** @typedef {{name: string, role: string, colour: string, is_grown: boolean, term: string | null}} Structure */
/** @typedef {{name: string, lines: Record<List, Entry[]>, settings: Record<string, Entry>, walls: Wall[], materials: Record<string, Entry>,
 *   structures: Structure[], is_locked: boolean}} Shape */
/** @typedef {{list: List, number: number}} Line the number counts from 1 */
/** @typedef {{list: List, kind: string}} Kind */
/** @typedef {(request: Record<string, unknown> & {do: string}) => Promise<Record<string, any>>} Ask */

/** What is drawn and dragged as a disc. */
const DISCS = new Set(["ends", "septal_defect", "close_defect", "ring", "pins"]);

export class Shaping {
  facts = new Signal(/** @type {Facts | null} */ (null));
  shape = new Signal(/** @type {Shape | null} */ (null));
  /** Whether the tab is open: only then the lines are drawn. */
  isOpen = new Signal(false);
  /** What a click places. */
  placing = new Signal(/** @type {Kind | null} */ (null));
  selected = new Signal(/** @type {Line | null} */ (null));
  /** The line that is being dragged, as it is now; of no line yet where its number is 0. */
  draft = new Signal(/** @type {{line: Line, entry: Entry} | null} */ (null));
  /** Ends that were found, and not taken yet. */
  found = new Signal(/** @type {Entry[] | null} */ (null));

  /** @param {Ask} ask @param {(error: unknown) => void} onFault */
  constructor(ask, onFault) {
    this.ask = ask;
    this.onFault = onFault;
  }

  /** The server says what the recipe says now. @param {Shape} shape */
  tell(shape) {
    const { selected } = this;
    this.shape.value = shape;
    if (selected.value && selected.value.number > shape.lines[selected.value.list].length) selected.value = null;
    this.draft.value = null;
  }

  /** All lines of some lists, with what is being dragged. @param {readonly List[]} lists @returns {{line: Line, entry: Entry}[]} */
  lines(lists) {
    const { shape, draft } = this;
    if (shape.value === null) return [];
    const { lines } = shape.value;
    const all = lists.flatMap((list) => lines[list].map((entry, n) => ({ line: { list, number: n + 1 }, entry })));
    const dragged = draft.value;
    if (dragged === null) return all;
    const others = all.filter(({ line }) => !isSame(line, dragged.line));
    return lists.includes(dragged.line.list) ? [...others, dragged] : others;
  }

  /** @param {Line | null} line @returns {Entry | null} */
  entryOf(line) {
    return line === null ? null : (this.shape.value?.lines[line.list][line.number - 1] ?? null);
  }

  /** @param {List} list @param {Entry[]} entries */
  async add(list, entries) {
    const answer = await this.#try({ do: "add", list, entries });
    // what was done is named by its place in the recipe: edits[2]
    const number = Number(/\[(\d+)\]$/.exec(answer?.undo_kind ?? "")?.[1] ?? 0);
    if (number > 0) this.selected.value = { list, number };
    return answer !== null;
  }

  /** @param {Line} line @param {Entry} was the line as it was shown @param {Entry} entry */
  change(line, was, entry) {
    return this.#try({ do: "change", ...line, was, entry });
  }

  /** @param {Line} line @param {Entry} was the line as it was shown */
  async remove(line, was) {
    if (!(await this.#try({ do: "remove", ...line, was }))) return;
    this.selected.value = null;
  }

  /** @param {readonly string[]} place @param {unknown} value null leaves it out */
  set(place, value) {
    return this.#try({ do: "set", place, value });
  }

  /** @param {NewLabel} entry a structure that can be painted from then on */
  async addLabel(entry) {
    return (await this.#try({ do: "add_label", entry })) !== null;
  }

  /** @param {string} label name of a structure that is not painted */
  removeLabel(label) {
    return this.#try({ do: "remove_label", label });
  }

  async findEnds() {
    try {
      const answer = await this.ask({ do: "find_ends" });
      this.found.value = answer.ends;
      return answer;
    } catch (error) {
      this.onFault(error);
      return null;
    }
  }

  /** How a disc lies at a place. @param {"vessel" | "septum"} about @param {Vector} mm */
  propose(about, mm) {
    return this.ask({ do: "propose", about, position_mm: rounded(mm, 2) });
  }

  /** @param {Record<string, unknown> & {do: string}} request @returns {Promise<Record<string, any> | null>} null where it was refused */
  async #try(request) {
    try {
      return await this.ask(request);
    } catch (error) {
      // what was typed or dragged is as it was before
      this.draft.value = null;
      if (this.shape.value) this.shape.value = { ...this.shape.value };
      this.onFault(error);
      return null;
    }
  }
}

/** @param {Line | null} one @param {Line | null} other */
export function isSame(one, other) {
  return one !== null && other !== null && one.list === other.list && one.number === other.number;
}

/** What kind of line it is, as facts have it. @param {List} list @param {Entry} entry @returns {string} */
export function kindOf(list, entry) {
  return typeof entry.kind === "string" ? entry.kind : list === "ends" || list === "pins" ? list : "";
}

/** The disc that a line is drawn as; null for one that is none. @param {List} list @param {Entry} entry @returns {Disc | null} */
export function discOf(list, entry) {
  const kind = kindOf(list, entry);
  if (!DISCS.has(kind)) return null;
  const centre = entry.position_mm ?? (entry.points_mm?.length === 1 ? entry.points_mm[0] : null);
  const radius = entry.radius_mm ?? entry.diameter_mm / 2;
  return centre && Number.isFinite(radius) && (entry.axis || kind === "pins") ? { centre, axis: entry.axis ?? [0, 0, 1], radius } : null;
}

/** A line that says where its disc is now. @param {List} list @param {Entry} entry @param {Disc} disc @returns {Entry} */
export function withDisc(list, entry, disc) {
  const centre = rounded(disc.centre, 1);
  const radius = Number(disc.radius.toFixed(1));
  const changed = { ...entry };
  if ("points_mm" in entry) changed.points_mm = [centre];
  else changed.position_mm = centre;
  if (list !== "pins") changed.axis = rounded(disc.axis, 3);
  if ("diameter_mm" in entry) changed.diameter_mm = Number((2 * disc.radius).toFixed(1));
  else changed.radius_mm = radius;
  // a long axis that would lie across the septum has no meaning: the server says so
  return changed;
}

/** Where a line is: what one looks at. @param {Entry} entry @returns {Vector | null} */
export function placeOf(entry) {
  const points = entry.points_mm;
  return entry.position_mm ?? (points ? points[Math.floor(points.length / 2)] : null);
}

/** What an incision is worth while it is held open: figures that the server works out beside the steps. */

import { element } from "../shared/elements.js";
import { saidOf } from "../shared/said.js";
import { figure, language, say, structureName } from "../shared/words.js";

/** @typedef {import("../shared/connection.js").Message} Message */
/** @typedef {import("../shared/words.js").Word} Word */
/** @typedef {Record<string, any>} Figures */

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/** Figures of the incision, whatever is seen through it: name, digits behind the point, unit, by how much it is shown larger. */
const OF_INCISION = /** @type {const} */ ([
  ["length_mm", 1, " mm", 1], ["gap_mm", 1, " mm", 1], ["retraction_n", 2, " N", 1], ["stretch_high", 2, "", 1], ["stretch", 2, "", 1],
  ["stress_high_kpa", 1, " kPa", 1], ["stress_kpa", 1, " kPa", 1], ["worst_stitch", 2, "", 1], ["reach_mm3", 0, " mm³", 1], ["cut_mm2", 0, " mm²", 1],
]);
/** Figures of a defect. */
const OF_DEFECT = /** @type {const} */ ([
  ["rim_seen_closed", 0, " %", 100], ["rim_seen_cut", 0, " %", 100], ["rim_seen", 0, " %", 100], ["rim_seen_best", 0, " %", 100],
  ["solid_angle_sr", 2, " msr", 1000], ["freedom_mm3", 0, " mm³", 1],
]);

/** A row for each figure that some of them has. @param {readonly Figures[]} all @param {typeof OF_INCISION | typeof OF_DEFECT} which */
export function rows(all, which) {
  /** @type {[string, string[]][]} */
  const found = [];
  for (const [name, digits, unit, larger] of which) {
    if (all.every((one) => one[name] === null)) continue;
    const cells = all.map((one) => (one[name] === null ? "–" : `${figure(larger * one[name], digits)}${unit}`));
    found.push([say(/** @type {Word} */ (`figure_${name}`)), cells]);
  }
  return found;
}

/** Figures without those that mean nothing: a cell that is inside out has no stretch and no stress. @param {Figures} figures @param {number} invertedCount */
export function trusted(figures, invertedCount) {
  return invertedCount > 0 ? { ...figures, stretch: null, stress_kpa: null } : figures;
}

/** Rows of how near it goes to each vessel. @param {readonly Figures[]} all */
export function vesselRows(all) {
  const names = [...new Set(all.flatMap((one) => Object.keys(one.nearest_mm)))].sort();
  return names.map((name) => /** @type {[string, string[]]} */ ([
    say("figure_nearest", { name: structureName(name) }), all.map((one) => ((one.nearest_mm[name] ?? null) === null ? "–" : `${figure(one.nearest_mm[name], 1)} mm`)),
  ]));
}

export const KINDS = { OF_INCISION, OF_DEFECT };

export class LiveFigures {
  /** @type {Message | null} */
  #message = null;
  /** @type {readonly string[]} */
  #planned = [];
  #isShown = false;
  #shape = "";

  /** @param {(request: Record<string, unknown> & {do: string}) => void} ask */
  constructor(ask) {
    this.ask = ask;
    this.choice = /** @type {HTMLSelectElement} */ (find("incision"));
    this.choice.addEventListener("change", () => this.#want({}));
    find("hold-open").addEventListener("click", () => ask({ do: "hold_open", incision: this.#incision }));
    find("reach").addEventListener("click", () => this.#want({ reach: true }));
    language.listen(() => {
      this.setPlanned(this.#planned);
      this.#fill();
    });
  }

  get #incision() {
    return Math.max(Number(this.choice.value || 0), 0);
  }

  /** Planned incisions of the case. @param {readonly string[]} names */
  setPlanned(names) {
    this.#planned = names;
    find("planned").hidden = names.length === 0;
    find("planned-cuts").replaceChildren(
      ...names.map((name) => {
        const button = element("button", "", name);
        button.type = "button";
        button.setAttribute("aria-label", `${say("figures_planned")} ${name}`);
        button.addEventListener("click", () => this.ask({ do: "cut_planned", incision: name }));
        return button;
      }),
    );
  }

  /** Whether the figures are looked at: only then they are worked out. @param {boolean} isShown */
  show(isShown) {
    if (isShown === this.#isShown) return;
    this.#isShown = isShown;
    this.#want({});
  }

  /** A server that does not know yet what is wanted. */
  begin() {
    this.#message = null;
    this.#fill();
    if (this.#isShown) this.#want({});
  }

  /** @param {Message} message */
  hear(message) {
    this.#message = message;
    this.#fill();
  }

  /** @param {{reach?: boolean}} more */
  #want(more) {
    this.ask({ do: "figures", shown: this.#isShown, incision: this.#incision, ...more });
  }

  #fill() {
    const message = this.#message;
    const cuts = message?.cuts ?? [];
    const found = message?.found ?? null;
    find("figures-none").hidden = cuts.length > 0;
    find("figures-tools").hidden = cuts.length === 0;
    this.#fillChoice(cuts);
    const isBusy = cuts.length > 0 && (found === null || message?.is_reaching);
    find("figures-state").textContent = isBusy ? say(message?.is_reaching ? "figures_reaching" : "figures_working") : "";
    /** @type {HTMLButtonElement} */ (find("reach")).disabled = Boolean(message?.is_reaching) || found === null;
    const remarks = (message?.problems ?? []).map(saidOf);
    if (found === null) {
      find("figures").replaceChildren();
      tell(remarks);
      return;
    }
    const first = trusted(found.defects[0].figures, found.inverted_cell_count);
    this.#table([
      ...found.defects.filter((/** @type {any} */ one) => one.name !== "").map((/** @type {any} */ one) => [one.name, rows([one.figures], OF_DEFECT)]),
      [found.name, [...rows([first], OF_INCISION), ...vesselRows([first])]],
    ]);
    remarks.push(say("figures_at", { time: figure(found.time_s, 2) }));
    if (found.defects.every((/** @type {any} */ one) => one.name === "")) remarks.unshift(say("figures_no_defect"));
    if (found.inverted_cell_count) remarks.unshift(say("figures_inverted", { count: figure(found.inverted_cell_count, 0) }));
    for (const one of found.defects) {
      if (one.rim_found !== null && one.rim_found < 1) {
        remarks.unshift(`${one.name}: ${say("figures_rim_found", { part: figure(100 * one.rim_found, 0) })}`);
      }
    }
    for (const one of found.problems) remarks.unshift(say("figures_left_out", { name: one.place, why: saidOf(one) }));
    tell(remarks);
  }

  /** Rows are filled in place: what is read or marked stays while figures change. @param {[string, [string, string[]][]][]} parts */
  #table(parts) {
    const shape = JSON.stringify(parts.map(([heading, lines]) => [heading, lines.map(([label]) => label)]));
    const list = find("figures");
    if (shape !== this.#shape || list.children.length === 0) {
      this.#shape = shape;
      list.replaceChildren(
        ...parts.map(([heading, lines]) => {
          const table = element("table");
          table.append(element("caption", "", heading));
          const body = element("tbody");
          for (const [label] of lines) {
            const row = element("tr");
            const head = element("th", "", label);
            head.scope = "row";
            row.append(head, element("td"));
            body.append(row);
          }
          table.append(body);
          return table;
        }),
      );
    }
    const cells = [...list.querySelectorAll("td")];
    parts.flatMap(([, lines]) => lines).forEach(([, [text]], n) => {
      if (cells[n].textContent !== text) cells[n].textContent = text;
    });
  }

  /** @param {readonly string[]} cuts names */
  #fillChoice(cuts) {
    const names = cuts.map((name, n) => `${n + 1} ${name}`);
    const there = [...this.choice.options].map((one) => one.text);
    if (JSON.stringify(there) === JSON.stringify(names)) return;
    const before = Math.min(this.#incision, Math.max(names.length - 1, 0));
    this.choice.replaceChildren(...names.map((name, n) => new Option(name, String(n), false, n === before)));
  }
}

/** @param {readonly string[]} remarks */
function tell(remarks) {
  find("figures-remarks").replaceChildren(...remarks.map((one) => element("p", "", one)));
}

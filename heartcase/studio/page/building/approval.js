/** Approving a case: once its report was opened and every warning looked at, by somebody in a role. */

import { figure, language, say } from "../shared/words.js";

/** @typedef {import("./build_tab.js").Case} Case */

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
/** @param {string} id */
const field = (id) => /** @type {HTMLInputElement} */ (find(id));

export class Approval {
  /** @type {Case | null} */
  #case = null;
  #isBusy = false;
  #isAsking = false;
  /** Hash of the case whose report was opened. */
  #read = "";

  /**
   * @param {(request: Record<string, unknown> & {do: string}) => Promise<void>} ask
   * @param {import("./results.js").Results} results
   */
  constructor(ask, results) {
    this.results = results;
    results.onSeen = () => this.#draw();
    find("approve-form").addEventListener("submit", (event) => {
      event.preventDefault();
      if (this.#case === null || !this.#mayApprove) return;
      void this.#asked(ask({
        do: "approve", role: field("approve-role").value, note: field("approve-note").value,
        sha256: this.#case.sha256, has_looked: true,
      }));
    });
    find("withdraw").addEventListener("click", () => {
      if (this.#case === null || this.#isAsking) return;
      // to approve it again is to look again
      field("approve-compared").checked = false;
      void this.#asked(ask({ do: "withdraw", role: field("approve-role").value, note: field("approve-note").value, sha256: this.#case.sha256 }));
    });
    field("approve-role").addEventListener("input", () => this.#draw());
    field("approve-compared").addEventListener("change", () => this.#draw());
    language.listen(() => this.#draw());
  }

  /** @param {Case} made @param {boolean} isBusy */
  show(made, isBusy) {
    if (this.#case?.sha256 !== made.sha256) field("approve-compared").checked = false;
    this.#case = made;
    this.#isBusy = isBusy;
    this.#draw();
  }

  reportWasOpened() {
    this.#read = this.#case?.sha256 ?? "";
    this.#draw();
  }

  /** One approval for a double click. @param {Promise<void>} answer */
  async #asked(answer) {
    this.#isAsking = true;
    this.#draw();
    await answer.finally(() => (this.#isAsking = false)).catch(() => undefined);
    this.#draw();
  }

  get #mayApprove() {
    const made = this.#case;
    return made !== null && !this.#isBusy && !this.#isAsking && this.#missing(made).length === 0 && field("approve-role").value.trim() !== "";
  }

  /** What is to be done before. @param {Case} made */
  #missing(made) {
    const missing = [];
    if (!made.has_report) missing.push(say("approve_no_report"));
    else if (this.#read !== made.sha256) missing.push(say("approve_read"));
    const odd = made.warnings.filter(({ grade }) => grade !== "note").length;
    if (!this.results.areSeen) missing.push(say("approve_look", { count: figure(odd, 0) }));
    if (!field("approve-compared").checked) missing.push(say("approve_compare"));
    return missing;
  }

  #draw() {
    const made = this.#case;
    if (made === null) return;
    const { state, role, time } = made.approval;
    const isApproved = state === "approved";
    const date = time === null ? "" : new Date(time).toLocaleDateString(language.value, { dateStyle: "medium" });
    const state_ = find("approve-state");
    state_.dataset.state = state;
    state_.textContent = isApproved
      ? say("approve_done", { role: role ?? "", date })
      : state === "changed since approval" ? say("approve_changed", { role: role ?? "", date }) : say("approve_draft");
    find("approve-missing").textContent = isApproved ? "" : this.#missing(made).join(" ");
    find("approve-compared-part").hidden = isApproved;
    find("approve").hidden = isApproved;
    find("withdraw").hidden = find("operate-approved").hidden = !isApproved;
    /** @type {HTMLButtonElement} */ (find("approve")).disabled = !this.#mayApprove;
    /** @type {HTMLButtonElement} */ (find("withdraw")).disabled = this.#isBusy || this.#isAsking || field("approve-role").value.trim() === "";
  }
}

/** The quick preview of the surface: asked for anew when labels or the recipe changed, one at a time. */

import { Signal } from "../shared/signal.js";
import { language, say } from "../shared/words.js";

/** @typedef {import("../shared/connection.js").Problem} Problem */
/** @typedef {import("../painting/pictures/views.js").Views} Views */
/** @typedef {import("./shaping.js").Ask} Ask */

/** Strokes and acts that follow on each other at once are waited for. */
const WAIT_MS = 5;
/** Until the first look is followed by the fine one. */
const FINE_AFTER_MS = 500;

export class Preview {
  isOn = new Signal(false);
  /** Cut open at the crosshair. */
  cuts = new Signal(false);
  /** Whether one is being made, or the fine one is due that follows a first look. */
  isBusy = new Signal(false);
  #isMaking = false;
  /** Whether a first look is being made. */
  isFirstLook = false;
  /** What is not in the surface, and why. */
  problems = new Signal(/** @type {readonly Problem[]} */ ([]));
  #isStale = false;
  #isCoarse = false;
  #timer = 0;

  /** @param {Views} views @param {Ask} ask @param {(error: unknown) => void} onFault @param {() => boolean} waits whether the fine look waits */
  constructor(views, ask, onFault, waits) {
    this.views = views;
    this.ask = ask;
    this.onFault = onFault;
    this.waits = waits;
    this.isOn.listen((isOn) => {
      if (isOn) this.refresh();
    });
  }

  /** Labels or the recipe changed. */
  refresh() {
    if (!this.isOn.value) return;
    this.#isStale = this.#isCoarse = true;
    this.#later(WAIT_MS);
  }

  /** @param {number} ms */
  #later(ms) {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => void this.#make(), ms);
  }

  async #make() {
    if (this.#isMaking || !this.isOn.value) return;
    if (!this.#isCoarse && this.waits()) {
      this.#later(FINE_AFTER_MS);
      return;
    }
    this.#isMaking = this.isBusy.value = true;
    try {
      while (this.#isStale && this.isOn.value) {
        const coarse = (this.isFirstLook = this.#isCoarse);
        this.#isStale = this.#isCoarse = false;
        const { problems } = await this.ask({ do: "preview", coarse });
        // what is wrong with ends and edits is told where they are looked at finely
        if (!coarse) this.problems.value = problems ?? [];
        else if (!this.#isStale) {
          this.#isStale = true;
          this.#later(FINE_AFTER_MS);
          break;
        }
      }
    } catch (error) {
      this.isOn.value = false;
      this.onFault(error);
    } finally {
      this.#isMaking = this.isFirstLook = false;
      this.isBusy.value = this.#isStale && this.isOn.value;
    }
  }

  /** A surface came. @param {{vertex_count: number, triangle_count: number}} header @param {Uint8Array<ArrayBuffer>} bytes */
  take({ vertex_count: vertices, triangle_count: triangles }, bytes) {
    // a copy begins where numbers of four bytes may begin
    const data = bytes.slice().buffer;
    const [positions, index] = [12 * vertices, 12 * triangles];
    this.views.surfaces.set(
      new Float32Array(data, 0, 3 * vertices),
      new Uint32Array(data, positions, 3 * triangles),
      new Uint8Array(data, positions + index, 3 * vertices),
      new Int8Array(data, positions + index + 3 * vertices, 3 * vertices),
    );
    this.views.redrawSolid();
  }
}

/**
 * The preview with its switches in the bar of the 3-D picture.
 * @param {Views} views
 * @param {Ask} ask
 * @param {(error: unknown) => void} onFault
 * @param {() => boolean} waits whether the fine look waits: a stroke is being drawn, or labels have still to come
 */
export function runPreview(views, ask, onFault, waits) {
  const find = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
  const preview = new Preview(views, ask, onFault, waits);
  const switches = /** @type {const} */ ([["preview-on", preview.isOn], ["preview-cut", preview.cuts]]);
  for (const [id, signal] of switches) {
    const box = /** @type {HTMLInputElement} */ (find(id));
    box.addEventListener("change", () => (signal.value = box.checked));
    signal.follow((value) => (box.checked = value));
    signal.listen(() => {
      views.surfaceShown = preview.isOn.value;
      views.surfaceCut = preview.cuts.value;
      views.redrawSolid();
    });
  }
  preview.isOn.follow((isOn) => (find("preview-cut-choice").hidden = !isOn));
  const tell = () => {
    const { isOn, isBusy, problems } = preview;
    const state = find("preview-state");
    const first = problems.value[0];
    state.textContent = !isOn.value ? "" : isBusy.value ? say("preview_busy") : first ? say("preview_without", { place: first.place }) : "";
    state.title = problems.value.map(({ place, message }) => `${place}: ${message}`).join("\n");
  };
  for (const signal of [preview.isOn, preview.isBusy, preview.problems]) {
    /** @type {import("../shared/signal.js").Signal<any>} */ (signal).listen(tell);
  }
  language.listen(tell);
  views.onRestored = () => preview.refresh();
  return preview;
}

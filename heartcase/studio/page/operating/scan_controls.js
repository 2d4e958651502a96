/** Which slices of the scan are shown, and where: asked of the server, one after the other, the newest place of each. */

/** @typedef {import("./camera.js").Vector} Vector */
/** @typedef {import("./picture.js").Picture} Picture */
/** @typedef {"axial" | "coronal" | "sagittal"} Standing */

/** To the right and down in each, as radiologists see it, and the axis along which it is led. @type {Record<Standing, {right: Vector, down: Vector, axis: number}>} */
const STANDING = {
  axial: { right: [1, 0, 0], down: [0, 1, 0], axis: 2 },
  coronal: { right: [1, 0, 0], down: [0, 0, -1], axis: 1 },
  sagittal: { right: [0, 1, 0], down: [0, 0, -1], axis: 0 },
};

/** Steps of the sliders of level and width, over all intensities. */
const WINDOW_STEPS = 400;

/** @param {string} id */
const find = (id) => /** @type {HTMLInputElement} */ (document.getElementById(id));

export class ScanControls {
  /** What is to be asked for, newest place of each. @type {Map<string, {point_mm: Vector, right: Vector, down: Vector}>} */
  #wanted = new Map();
  #isAsking = false;
  /** Intensities that are black and white; null as at first. @type {[number, number] | null} */
  #window = null;
  /** Lowest and highest intensity of the scan for which the sliders stand. @type {[number, number] | null} */
  #range = null;
  /** @type {[Vector, Vector]} */
  #box = [[0, 0, 0], [1, 1, 1]];

  /**
   * @param {Picture} picture
   * @param {(request: Record<string, unknown> & {do: string}) => Promise<unknown>} ask
   * @param {(error: unknown) => void} failed
   */
  constructor(picture, ask, failed) {
    this.picture = picture;
    this.ask = ask;
    this.failed = failed;
    for (const name of ["cut", ...Object.keys(STANDING)]) {
      find(`scan-${name}`).addEventListener("change", () => this.#update(name));
      if (name !== "cut") find(`scan-${name}-at`).addEventListener("input", () => this.#update(name));
    }
    picture.plane.listen(() => this.#update("cut"));
    for (const name of ["level", "width"]) find(`scan-${name}`).addEventListener("input", () => this.#takeWindow());
  }

  /** What the sliders of level and width say. */
  #takeWindow() {
    const [level, width] = ["level", "width"].map((name) => Number(find(`scan-${name}`).value));
    this.#window = [level - width / 2, level + width / 2];
    for (const name of ["cut", ...Object.keys(STANDING)]) this.#update(name);
  }

  /** Let the sliders show how a slice is shown. @param {{window: [number, number], range: [number, number]}} header */
  #tellWindow({ window: [black, white], range }) {
    if (this.#range?.join() !== range.join()) {
      // of another scan: as that is shown at first
      const isOther = this.#window !== null;
      this.#range = range;
      this.#window = null;
      if (isOther) for (const name of ["cut", ...Object.keys(STANDING)]) this.#update(name);
      const step = (range[1] - range[0]) / WINDOW_STEPS || 1;
      Object.assign(find("scan-level"), { step, min: range[0], max: range[1], disabled: false });
      Object.assign(find("scan-width"), { step, min: step, max: Math.max(range[1] - range[0], step), disabled: false });
    }
    if (this.#window !== null) return;
    find("scan-level").value = String((black + white) / 2);
    find("scan-width").value = String(white - black);
  }

  /** @param {boolean} isKnown whether there is a scan @param {[Vector, Vector]} box around the heart */
  setCase(isKnown, box) {
    this.#box = box;
    find("scan-controls").hidden = !isKnown;
    for (const [name, { axis }] of Object.entries(STANDING)) {
      const slider = find(`scan-${name}-at`);
      const [low, high] = [Math.floor(box[0][axis] - 10), Math.ceil(box[1][axis] + 10)];
      if (Number(slider.min) !== low || Number(slider.max) !== high) {
        Object.assign(slider, { min: low, max: high });
        slider.value = String(Math.round((low + high) / 2));
      }
    }
    if (!isKnown) for (const name of ["cut", ...Object.keys(STANDING)]) find(`scan-${name}`).checked = false;
    for (const name of ["cut", ...Object.keys(STANDING)]) this.#update(name);
  }

  /** @param {string} name */
  #update(name) {
    const { plane, slices } = this.picture;
    const isShown = find(`scan-${name}`).checked && (name !== "cut" || plane.isOn);
    if (name !== "cut") find(`scan-${name}-at`).disabled = !isShown;
    if (!isShown) {
      this.#wanted.delete(name);
      slices.hide(name);
      this.picture.redraw();
      return;
    }
    if (name === "cut") {
      const [right, up] = plane.axes;
      this.#wanted.set(name, { point_mm: plane.point, right, down: [-up[0], -up[1], -up[2]] });
    } else {
      const { right, down, axis } = STANDING[/** @type {Standing} */ (name)];
      const [low, high] = this.#box;
      /** @type {Vector} */
      const point = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2];
      point[axis] = Number(find(`scan-${name}-at`).value);
      this.#wanted.set(name, { point_mm: point, right, down });
    }
    void this.#go();
  }

  async #go() {
    if (this.#isAsking) return;
    this.#isAsking = true;
    for (let next = [...this.#wanted][0]; next !== undefined; next = [...this.#wanted][0]) {
      const [name, place] = next;
      this.#wanted.delete(name);
      try {
        await this.ask({ do: "slice", name, ...place, window: this.#window });
      } catch (error) {
        this.#wanted.clear();
        for (const one of ["cut", ...Object.keys(STANDING)]) find(`scan-${one}`).checked = false;
        for (const one of ["cut", ...Object.keys(STANDING)]) this.picture.slices.hide(one);
        this.failed(error);
      }
    }
    this.#isAsking = false;
  }

  /** @param {any} header @param {Record<string, any>} arrays */
  take(header, arrays) {
    // it may have been switched off meanwhile
    if (!find(`scan-${header.name}`).checked || (header.name === "cut" && !this.picture.plane.isOn)) return;
    this.#tellWindow(header);
    this.picture.slices.show(header, arrays.greys, header.arrays.greys.shape);
    this.picture.redraw();
  }
}

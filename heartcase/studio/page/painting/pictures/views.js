/** The three slices and the solids: drawn into one canvas behind their tiles, each only when it changed. */

import { Lattice, plus } from "../../shared/geometry.js";
import { PATIENT_PLANES, turned, turnedPlanes } from "./planes.js";
import { drawOverlay, drawSolidOverlay, sidesOf } from "./overlay.js";
import { SliceShader } from "./slice_shader.js";
import { fitToSurface, SliceView } from "./slice_view.js";
import { lightOf, SolidShader } from "./solid_shader.js";
import { SolidView } from "./solid_view.js";
import { SurfaceShader } from "./surface_shader.js";
import { Volume } from "./volume.js";
import { say } from "../../shared/words.js";

/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../studio.js").ViewName} ViewName */
/** @typedef {import("../tools/measures.js").Measures} Measures */

const TURN_STEP_DEGREES = 5;
/** Part of their opacity that labels have while a single one takes the whole scan. */
const UNBOUNDED = 0.2;

/** The browser gives no WebGL 2. */
export class NoGraphics extends Error {}

export class Views {
  /** @type {Volume | null} */
  volume = null;
  #isAsked = false;
  #waits = false;
  /** Whether the 3-D picture shows the surface that came, and whether it is cut open at the crosshair. */
  surfaceShown = false;
  surfaceCut = false;
  /** The graphics card forgot everything: what another part of the page had given it must come again. */
  onRestored = () => {};
  /** Pictures were moved in their tiles: another place lies under the pointer. */
  onMoved = () => {};
  /** What other parts of the page draw over the slices. @type {((view: SliceView, thickness: number) => void)[]} */
  over = [];
  /** And over the solids. @type {((view: SolidView) => void)[]} */
  overSolid = [];

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Record<ViewName, HTMLElement>} tiles
   * @param {HTMLElement} solidTile
   * @param {Studio} studio
   * @param {Measures} measures
   */
  constructor(canvas, tiles, solidTile, studio, measures) {
    this.canvas = canvas;
    this.studio = studio;
    this.measures = measures;
    // Kept, so that a slice which did not change is not drawn again.
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, depth: false, preserveDrawingBuffer: true });
    if (gl === null) throw new NoGraphics();
    this.gl = gl;
    this.slices = new SliceShader(gl);
    this.solids = new SolidShader(gl);
    this.surfaces = new SurfaceShader(gl);
    gl.enable(gl.SCISSOR_TEST);
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.slices = new SliceShader(gl);
      this.solids = new SolidShader(gl);
      this.surfaces = new SurfaceShader(gl);
      this.onRestored();
      gl.enable(gl.SCISSOR_TEST);
      this.volume?.restore();
      this.redraw();
    });
    const views = Object.entries(tiles).map(([name, tile]) => new SliceView(/** @type {ViewName} */ (name), tile, studio));
    this.all = views;
    this.byName = /** @type {Record<ViewName, SliceView>} */ (Object.fromEntries(views.map((view) => [view.name, view])));
    this.solid = new SolidView(solidTile);
    const observer = new ResizeObserver(() => this.#resized());
    for (const view of views) observer.observe(view.surface);
    observer.observe(this.solid.surface);
    observer.observe(canvas);
    this.#follow();
  }

  get active() {
    return this.byName[this.studio.activeView.value];
  }

  /** A new scan: its lattice, with textures to come. @param {Vector} size @param {number[][]} indexToWorld */
  begin(size, indexToWorld) {
    const { studio } = this;
    this.volume?.dispose();
    this.volume = new Volume(this.gl, size);
    const lattice = new Lattice(size, indexToWorld);
    const isSame = JSON.stringify(studio.lattice.value) === JSON.stringify(lattice);
    studio.lattice.value = lattice;
    this.#setColours();
    // After a lost connection one goes on looking at the same place.
    if (!isSame) {
      studio.planes.value = PATIENT_PLANES;
      studio.crosshair.value = lattice.clamped(lattice.toWorld(/** @type {Vector} */ (size.map((n) => Math.floor(n / 2)))));
      this.fit();
    }
  }

  fit() {
    const lattice = this.studio.lattice.value;
    if (lattice === null) return;
    for (const view of [...this.all, this.solid]) view.camera.fit(lattice);
    this.onMoved();
    this.redraw();
  }

  /** The slices go to a position. @param {Vector} mm */
  lookAt(mm) {
    this.studio.crosshair.value = mm;
    for (const view of this.all) view.bringIntoSight(mm);
    this.onMoved();
    this.redraw();
  }

  /** The other slices turn about the crosshair in one of them. @param {ViewName} name @param {number} angle radians, from right to below */
  turnAbout(name, angle) {
    const { planes, crosshair } = this.studio;
    const about = planes.value.frames[name];
    for (const { name: other, camera } of this.all) {
      // what lies at the crosshair stays where it is seen
      if (other !== name) camera.centre = plus(crosshair.value, turned(plus(camera.centre, crosshair.value, -1), about, angle));
    }
    planes.value = turnedPlanes(planes.value, name, angle);
  }

  /** The others turn by a step about the slice that had the focus last. @param {-1 | 1} way */
  turnStep(way) {
    this.turnAbout(this.active.name, (way * TURN_STEP_DEGREES * Math.PI) / 180);
  }

  /** Labels of a box came. @param {Vector} low @param {Vector} size @param {Uint8Array<ArrayBuffer>} bytes */
  setLabels(low, size, bytes) {
    const lattice = this.studio.lattice.value;
    if (this.volume === null || lattice === null) return;
    this.volume.setLabels(low, size, bytes);
    for (const view of this.all) view.noteLabels(lattice, low, size);
    this.solid.isStale = true;
    this.#ask();
  }

  /**
   * Labels of several boxes came, one after the other in the bytes.
   * @param {readonly number[][]} boxes first voxel and size of each
   * @param {Uint8Array<ArrayBuffer>} bytes
   */
  setBoxes(boxes, bytes) {
    let at = 0;
    for (const [i, j, k, ...size] of boxes) {
      const count = size[0] * size[1] * size[2];
      this.setLabels([i, j, k], /** @type {Vector} */ (size), bytes.subarray(at, at + count));
      at += count;
    }
    if (at !== bytes.length) throw new Error("labels have not as many bytes as voxels");
  }

  /** While labels of a slice have not come yet, what is there stays. @param {boolean} waits */
  set waits(waits) {
    this.#waits = waits;
    if (!waits) this.#ask();
  }

  /** Everything is drawn anew with the next frame. */
  redraw() {
    for (const view of [...this.all, this.solid]) view.isStale = true;
    this.#ask();
  }

  /** The solids are drawn anew: one looks from elsewhere. */
  redrawSolid() {
    this.solid.isStale = true;
    this.#ask();
  }

  #redrawSlices() {
    for (const view of this.all) view.isStale = true;
    this.#ask();
  }

  /** What lies over all pictures is drawn anew. */
  redrawAllOverlays() {
    this.solid.overlayIsStale = true;
    this.redrawOverlays();
  }

  /** What lies over the slices is drawn anew. */
  redrawOverlays() {
    for (const view of this.all) view.overlayIsStale = true;
    this.#ask();
  }

  #follow() {
    const { studio } = this;
    for (const signal of [studio.window, studio.opacity, studio.outline, studio.labelsShown]) signal.listen(() => this.#redrawSlices());
    let wasUnbounded = studio.isUnbounded;
    studio.marked.listen(() => {
      if (studio.isUnbounded !== wasUnbounded) this.#redrawSlices();
      wasUnbounded = studio.isUnbounded;
    });
    for (const signal of [studio.hover, studio.stroke, studio.radiusMm, studio.erasing, studio.tool, studio.picked, studio.panning]) {
      signal.listen(() => this.redrawOverlays());
    }
    this.measures.changed.listen(() => this.redrawOverlays());
    studio.stroke.listen((stroke) => {
      if (stroke === null) this.#ask();
    });
    for (const signal of [studio.labels, studio.hidden]) {
      signal.listen(() => {
        this.#setColours();
        this.redraw();
      });
    }
    studio.planes.listen(({ name, frames }) => {
      for (const view of this.all) view.camera.frame = frames[view.name];
      if (name === "turned") this.redraw();
      else this.fit();
    });
    let before = studio.crosshair.value;
    studio.crosshair.listen((now) => {
      const moved = /** @type {Vector} */ (now.map((value, a) => value - before[a]));
      before = now;
      for (const view of this.all) {
        const { normal } = view.camera.frame;
        if (Math.abs(normal[0] * moved[0] + normal[1] * moved[1] + normal[2] * moved[2]) > 1e-6) view.isStale = true;
      }
      this.solid.overlayIsStale = true;
      if (this.surfaceShown && this.surfaceCut) this.solid.isStale = true;
      this.redrawOverlays();
    });
  }

  #setColours() {
    const { labels, hidden } = this.studio;
    this.volume?.setColours(labels.value.filter(({ value }) => !hidden.value.has(value)));
  }

  #resized() {
    const ratio = globalThis.devicePixelRatio || 1;
    const width = Math.max(Math.round(this.canvas.clientWidth * ratio), 1);
    const height = Math.max(Math.round(this.canvas.clientHeight * ratio), 1);
    if (width !== this.canvas.width || height !== this.canvas.height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    const { gl } = this;
    // What was drawn where no view is now must not stay.
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.SCISSOR_TEST);
    for (const view of [...this.all, this.solid]) {
      fitToSurface(view);
      view.isStale = true;
    }
    // Drawn at once: a canvas whose size changed is empty.
    this.#draw();
  }

  #ask() {
    if (this.#isAsked) return;
    this.#isAsked = true;
    requestAnimationFrame(() => {
      this.#isAsked = false;
      this.#draw();
    });
  }

  #draw() {
    const { studio, volume } = this;
    const lattice = studio.lattice.value;
    if (lattice === null || volume === null || !volume.isComplete || this.#waits) return;
    for (const view of this.all) {
      const part = view.isStale || view.changed !== null ? this.#partOf(view) : null;
      const stale = part && view.stalePart(part);
      if (part && stale) {
        const shown = studio.labelsShown.value;
        const look = {
          ...studio.window.value,
          opacity: shown ? studio.opacity.value * (studio.isUnbounded ? UNBOUNDED : 1) : 0,
          outline: shown && studio.outline.value,
        };
        this.slices.draw(volume, lattice, view.camera, studio.crosshair.value, look, part, stale);
      }
      if (view.isStale || view.overlayIsStale) {
        drawOverlay(view.pen, view.name, view.camera, studio, this.measures.all);
        for (const draw of this.over) draw(view, lattice.sliceStep(view.camera.frame.normal));
        this.#tellPosition(view, lattice);
      }
      view.isStale = view.overlayIsStale = false;
      view.changed = null;
    }
    this.#drawSolid(volume, lattice);
  }

  /** @param {Volume} volume @param {Lattice} lattice */
  #drawSolid(volume, lattice) {
    const { solid, studio } = this;
    if (solid.isStale || solid.overlayIsStale) {
      drawSolidOverlay(solid.pen, solid.camera, studio.crosshair.value);
      for (const draw of this.overSolid) draw(solid);
    }
    solid.overlayIsStale = false;
    if (this.surfaceShown && this.surfaces.isThere) {
      if (solid.isStale) {
        const { camera, look } = solid;
        const through = this.surfaceCut ? studio.crosshair.value : null;
        this.surfaces.draw(lattice, camera, look, lightOf(camera, look), this.#partOf(solid), through);
      }
      solid.isStale = false;
      return;
    }
    if (!solid.isStale || this.solids.isBusy || (studio.stroke.value !== null && !solid.isQuick)) return;
    const { share } = solid;
    volume.updateBlocks();
    solid.isStale = false;
    const shader = this.solids;
    const when = () => {
      if (this.volume !== volume || this.solids !== shader || (this.surfaceShown && this.surfaces.isThere)) return "never";
      // While a stroke is drawn the slices come first.
      return studio.stroke.value === null || solid.isQuick ? "now" : "later";
    };
    shader.draw(volume, lattice, solid.camera, solid.look, () => this.#partOf(solid), share, when, (ms) => {
      solid.fullMs = ms / share ** 2;
      if (solid.isStale) this.#ask();
    });
  }

  /** Where a view lies in the canvas, device pixels from below. @param {SliceView | SolidView} view */
  #partOf(view) {
    const origin = this.canvas.getBoundingClientRect();
    const at = view.surface.getBoundingClientRect();
    return {
      x: Math.round((at.left - origin.left) * view.ratio),
      y: this.canvas.height - Math.round((at.bottom - origin.top) * view.ratio),
      width: view.overlay.width,
      height: view.overlay.height,
    };
  }

  /** @param {SliceView} view @param {Lattice} lattice */
  #tellPosition(view, lattice) {
    const { at, count } = view.slices(lattice);
    const { slider } = view;
    slider.max = String(count - 1);
    slider.value = String(at);
    const sides = /** @type {HTMLElement} */ (view.tile.querySelector(".sides"));
    const words = say("sides", sidesOf(view.camera));
    if (sides.textContent !== words) sides.textContent = words;
    const text = say("slice_of", { at: at + 1, count });
    if (slider.getAttribute("aria-valuetext") !== text) {
      slider.setAttribute("aria-valuetext", text);
      const output = /** @type {HTMLElement} */ (view.tile.querySelector("output"));
      output.textContent = text;
    }
  }
}

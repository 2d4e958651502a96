/** What mouse, pen and fingers do on the slices. */

/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {import("../pictures/slice_view.js").SliceView} SliceView */
/** @typedef {import("../pictures/views.js").Views} Views */
/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("./brush.js").Brush} Brush */
/** @typedef {import("./measures.js").Measures} Measures */
/** @typedef {{x: number, y: number}} Point */
/** @typedef {{kind: "pan" | "window" | "crosshair" | "paint" | "measure" | "shape" | "fingers" | "turn", view: SliceView, pointer: number, x: number, y: number, moved: boolean, isRaw?: boolean}} Drag */

import { draggedWindow } from "../../shared/geometry.js";
import { handlesOf, isOnHandle } from "../pictures/planes.js";

/** Wheel travel of one slice, pixels: that of one notch on most mice is 100 to 120. */
const WHEEL_STEP = 60;
/** A finger that stays this long, or goes this far, is a stroke and not the first of two. */
const FINGER_MS = 120;
const FINGER_PIXELS = 6;
/** Fingers are not looked at so shortly after a pen: the hand rests on the screen. */
const PALM_MS = 800;
const PEN_ERASER = 32;

export class Pointers {
  /** @type {Drag | null} */
  #drag = null;
  /** Fingers on the screen: where each is. @type {Map<number, Point>} */
  #fingers = new Map();
  /** A finger's stroke that may yet turn out to be a pinch. @type {{view: SliceView, at: Point, timer: number} | null} */
  #pending = null;
  #wheel = 0;
  #penAt = -Infinity;
  /** Space was held for a drag, and not for a swap of tools. */
  hasPanned = false;
  /** What acts on the lines of the recipe. @type {import("../../shaping/hands.js").Hands | null} */
  hands = null;

  /**
   * @param {Views} views
   * @param {Studio} studio
   * @param {Brush} brush
   * @param {Measures} measures
   */
  constructor(views, studio, brush, measures) {
    this.views = views;
    this.studio = studio;
    this.brush = brush;
    this.measures = measures;
    for (const view of views.all) this.#listen(view);
    for (const signal of [studio.crosshair, studio.planes]) {
      /** @type {import("../../shared/signal.js").Signal<any>} */ (signal).listen(() => this.#stay());
    }
    views.onMoved = () => this.#stay();
  }

  /** @param {SliceView} view */
  #listen(view) {
    const { surface } = view;
    surface.addEventListener("pointerdown", (event) => this.#down(view, event));
    surface.addEventListener("pointermove", (event) => this.#move(view, event));
    // Movements as they come: those above wait for the browser's next picture.
    surface.addEventListener("pointerrawupdate", (event) => this.#paintOn(/** @type {PointerEvent} */ (event)));
    surface.addEventListener("pointerup", (event) => this.#up(event));
    surface.addEventListener("pointercancel", (event) => this.#up(event));
    surface.addEventListener("lostpointercapture", (event) => this.#up(event));
    surface.addEventListener("pointerleave", () => {
      if (this.#drag === null) this.studio.hover.value = null;
    });
    surface.addEventListener("contextmenu", (event) => event.preventDefault());
    surface.addEventListener("wheel", (event) => this.#turn(view, event), { passive: false });
    surface.addEventListener("focus", () => (this.studio.activeView.value = view.name));
    surface.addEventListener("dblclick", (event) => {
      if (this.studio.tool.value !== "pointer" || event.button !== 0) return;
      this.studio.large.value = this.studio.large.value === view.name ? null : view.name;
    });
  }

  /** @param {SliceView} view @param {Point} at */
  #pointAt(view, { x, y }) {
    this.studio.hover.value = { view: view.name, mm: view.toMm(x, y), x, y };
  }

  /** The pointer rests while the picture below it moves: by keys, a slider, another plane. */
  #stay() {
    const { hover } = this.studio;
    if (hover.value !== null) this.#pointAt(this.views.byName[hover.value.view], hover.value);
  }

  /** @param {SliceView} view @param {PointerEvent} event */
  #down(view, event) {
    event.preventDefault();
    view.surface.focus({ preventScroll: true });
    const at = positionOf(view, event);
    if (event.pointerType === "pen") this.#penAt = event.timeStamp;
    if (event.pointerType === "touch") {
      if (event.timeStamp - this.#penAt < PALM_MS) return;
      this.#fingers.set(event.pointerId, at);
      if (this.#fingers.size > 1) {
        this.#secondFinger(view, event);
        return;
      }
    }
    if (this.#drag !== null || this.studio.lattice.value === null) return;
    let kind = this.#kindOf(event);
    if (kind === null) return;
    // where no line is, the crosshair is moved
    if (kind === "shape" && !this.hands?.down(view, at)) kind = "crosshair";
    if (kind === "crosshair" && !event.shiftKey && this.#isOnHandle(view, at)) kind = "turn";
    view.surface.setPointerCapture(event.pointerId);
    this.#drag = { kind, view, pointer: event.pointerId, ...at, moved: false };
    this.#pointAt(view, at);
    if (kind === "pan") this.hasPanned = true;
    if (kind === "crosshair") this.#moveCrosshair(view, at);
    if (kind === "measure") this.#setMeasure(view, at);
    if (kind === "paint" && event.pointerType === "touch") {
      this.#pending = { view, at, timer: window.setTimeout(() => this.#settle(false), FINGER_MS) };
    } else if (kind === "paint") {
      this.#beginStroke(view, at, event.altKey || (event.buttons & PEN_ERASER) !== 0);
    }
  }

  /** @param {PointerEvent} event @returns {Drag["kind"] | null} */
  #kindOf(event) {
    const { tool, panning } = this.studio;
    if (event.button === 1 || (event.button === 0 && panning.value)) return "pan";
    if (event.button === 2) return "window";
    if (event.button !== 0 && event.button !== 5) return null;
    if (tool.value === "pointer" || event.shiftKey) return "crosshair";
    if (tool.value === "shape") return "shape";
    return tool.value === "ruler" || tool.value === "angle" ? "measure" : "paint";
  }

  /** @param {SliceView} view @param {Point} at @param {boolean} erases */
  #beginStroke(view, at, erases) {
    if (!this.brush.begin(view.toMm(at.x, at.y), erases || this.studio.erases)) this.#drag = null;
  }

  /** A finger's stroke begins now. @param {boolean} isLifted */
  #settle(isLifted) {
    const pending = this.#pending;
    if (pending === null) return;
    window.clearTimeout(pending.timer);
    this.#pending = null;
    this.#beginStroke(pending.view, pending.at, false);
    if (isLifted) this.brush.end();
  }

  /** Two fingers zoom and pan; a stroke that had only just begun is none. @param {SliceView} view @param {PointerEvent} event */
  #secondFinger(view, event) {
    if (this.#pending !== null) {
      window.clearTimeout(this.#pending.timer);
      this.#pending = null;
    } else if (this.brush.isDown) {
      return;
    }
    this.measures.drop();
    this.hands?.drop();
    view.surface.setPointerCapture(event.pointerId);
    this.#drag = { kind: "fingers", view, pointer: event.pointerId, x: 0, y: 0, moved: true };
    this.studio.hover.value = null;
  }

  /** @param {SliceView} view @param {PointerEvent} event */
  #move(view, event) {
    const drag = this.#drag;
    if (event.pointerType === "pen") this.#penAt = event.timeStamp;
    if (drag?.kind === "fingers") {
      this.#moveFinger(drag.view, event);
      return;
    }
    const over = drag?.view ?? view;
    const at = positionOf(over, event);
    if (event.pointerType === "touch" && this.#fingers.has(event.pointerId)) this.#fingers.set(event.pointerId, at);
    if (drag === null) {
      view.surface.style.cursor = this.#isOnHandle(view, at) ? "grab" : "";
      if (event.shiftKey && event.buttons === 0) this.#moveCrosshair(view, at);
      this.#pointAt(view, at);
      this.measures.follow(view.toMm(at.x, at.y));
      return;
    }
    if (event.pointerId !== drag.pointer) return;
    const dx = at.x - drag.x;
    const dy = at.y - drag.y;
    drag.moved ||= Math.hypot(dx, dy) > 3;
    if (this.#pending) {
      if (Math.hypot(dx, dy) < FINGER_PIXELS) return;
      this.#settle(false);
    }
    this.#pointAt(over, at);
    if (drag.kind === "paint") {
      if (!drag.isRaw) this.#extend(over, event);
      return;
    }
    if (drag.kind === "shape") {
      this.hands?.move(at);
      return;
    }
    if (drag.kind === "measure") {
      this.measures.follow(over.toMm(at.x, at.y));
      return;
    }
    if (drag.kind === "pan") {
      over.camera.pan(dx, dy);
      over.isStale = true;
      this.views.redrawOverlays();
    }
    if (drag.kind === "window") this.studio.window.value = draggedWindow(this.studio.window.value, dx, dy);
    if (drag.kind === "crosshair") this.#moveCrosshair(over, at);
    if (drag.kind === "turn") this.#turnPlanes(over, drag, at);
    drag.x = at.x;
    drag.y = at.y;
  }

  /** A stroke goes on before the browser's next picture. @param {PointerEvent} event */
  #paintOn(event) {
    const drag = this.#drag;
    if (drag?.kind !== "paint" || event.pointerId !== drag.pointer || this.#pending) return;
    drag.isRaw = true;
    this.#extend(drag.view, event);
  }

  /** @param {SliceView} view @param {PointerEvent} event */
  #extend(view, event) {
    const events = event.getCoalescedEvents?.() ?? [];
    this.brush.extend((events.length ? events : [event]).map((one) => {
      const { x, y } = positionOf(view, one);
      return view.toMm(x, y);
    }));
  }

  /** @param {SliceView} view @param {PointerEvent} event */
  #moveFinger(view, event) {
    const before = this.#fingers.get(event.pointerId);
    const other = [...this.#fingers].find(([pointer]) => pointer !== event.pointerId)?.[1];
    const at = positionOf(view, event);
    if (!before || !other) return;
    this.#fingers.set(event.pointerId, at);
    const factor = Math.hypot(at.x - other.x, at.y - other.y) / Math.max(Math.hypot(before.x - other.x, before.y - other.y), 1);
    // Each finger moves the middle by half of its own way.
    view.camera.pan((at.x - before.x) / 2, (at.y - before.y) / 2);
    view.camera.zoom(factor, (at.x + other.x) / 2, (at.y + other.y) / 2);
    view.isStale = true;
    this.views.redrawOverlays();
  }

  /** @param {PointerEvent} event */
  #up(event) {
    this.#fingers.delete(event.pointerId);
    const drag = this.#drag;
    if (drag?.kind === "fingers") {
      // The finger that stays does nothing until it is lifted too.
      if (this.#fingers.size === 0) this.#drag = null;
      return;
    }
    if (drag === null || event.pointerId !== drag.pointer) return;
    this.#drag = null;
    if (drag.kind === "paint") {
      this.#settle(true);
      this.brush.end();
    }
    if (drag.kind === "shape") this.hands?.up();
    // A ruler is drawn by dragging, or by clicks.
    if (drag.kind === "measure" && drag.moved) this.#setMeasure(drag.view, positionOf(drag.view, event));
    if (event.pointerType === "touch") this.studio.hover.value = null;
  }

  /** The connection was lost, or the like: whatever is dragged is let go. */
  letGo() {
    if (this.#pending) window.clearTimeout(this.#pending.timer);
    this.#pending = this.#drag = null;
    this.hands?.drop();
    this.brush.drop();
  }

  /** @param {SliceView} view @param {Point} at */
  #moveCrosshair(view, at) {
    const lattice = this.studio.lattice.value;
    if (lattice) this.studio.crosshair.value = lattice.clamped(view.toMm(at.x, at.y));
  }

  /** Whether a handle that turns the other planes is under the pointer. @param {SliceView} view @param {Point} at */
  #isOnHandle(view, at) {
    const { studio } = this;
    if (studio.tool.value !== "pointer" || studio.panning.value || studio.lattice.value === null) return false;
    const cross = view.camera.toPixel(studio.crosshair.value, studio.crosshair.value);
    return isOnHandle(handlesOf(studio.planes.value, view.name, view.camera, cross), at);
  }

  /** The other planes follow the pointer about the crosshair. @param {SliceView} view @param {Point} before @param {Point} at */
  #turnPlanes(view, before, at) {
    const { x, y } = view.camera.toPixel(this.studio.crosshair.value, this.studio.crosshair.value);
    const angle = Math.atan2(at.y - y, at.x - x) - Math.atan2(before.y - y, before.x - x);
    this.views.turnAbout(view.name, angle);
  }

  /** @param {SliceView} view @param {Point} at */
  #setMeasure(view, at) {
    const tool = this.studio.tool.value;
    if (tool === "ruler" || tool === "angle") this.measures.set(tool, view.toMm(at.x, at.y));
  }

  /** @param {SliceView} view @param {WheelEvent} event */
  #turn(view, event) {
    event.preventDefault();
    const unit = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 33 : event.deltaMode === WheelEvent.DOM_DELTA_PAGE ? 300 : 1;
    // With shift held browsers turn the wheel sideways.
    const travel = (event.deltaY || event.deltaX) * unit;
    const at = positionOf(view, event);
    if (event.ctrlKey || event.metaKey) {
      view.camera.zoom(Math.exp(-travel / 400), at.x, at.y);
      view.isStale = true;
      this.#pointAt(view, at);
      this.views.redrawOverlays();
      return;
    }
    this.#wheel += travel;
    // One notch is one step on every mouse; a touch pad's many small ones add up.
    const steps = Math.abs(travel) >= WHEEL_STEP ? Math.sign(travel) : Math.trunc(this.#wheel / WHEEL_STEP);
    if (steps === 0) return;
    this.#wheel = 0;
    if (event.shiftKey) this.studio.resizeBrush(-steps);
    else view.scroll(-steps);
    this.#pointAt(view, at);
  }
}

/** @param {SliceView} view @param {MouseEvent} event @returns {Point} */
function positionOf(view, event) {
  const box = view.surface.getBoundingClientRect();
  return { x: event.clientX - box.left, y: event.clientY - box.top };
}

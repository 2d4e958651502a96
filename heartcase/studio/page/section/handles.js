/**
 * Two handles of a cut plane on the picture, for pointers and keys: one leads it along its normal, the other, at the normal's end, turns it.
 *
 * They are elements of the page over the picture, each a slider in words: arrows act on the one that has the focus.
 */

import { add, cross, dot, unit } from "../operating/camera.js";
import { figure, say } from "../shared/words.js";

/** @typedef {import("../operating/camera.js").Camera} Camera */
/** @typedef {import("../operating/camera.js").Vector} Vector */
/** @typedef {import("./plane.js").CutPlane} CutPlane */

const STEP_MM = 1;
const PAGE_MM = 5;
const TURN = Math.PI / 36;
/** How long the normal is seen, pixels. */
const NORMAL_PIXELS = 70;
/** Handles are so far apart at least, pixels. */
const APART_PIXELS = 36;
/** Part of the normal that must be seen from the side for the pointer to lead the plane along it. */
const ASIDE = 0.15;

/** @param {number} value @param {number} most */
const clamped = (value, most) => Math.min(Math.max(value, 16), most - 16);

export class PlaneHandles {
  #move;
  #turn;
  #line;
  /** Where the pointer was. @type {{x: number, y: number} | null} */
  #last = null;

  /**
   * @param {HTMLElement} surface what they are laid over: its corner is the picture's
   * @param {Camera} camera
   * @param {CutPlane} plane
   */
  constructor(surface, camera, plane) {
    this.camera = camera;
    this.plane = plane;
    this.#line = document.createElement("span");
    this.#line.className = "plane-normal";
    this.#line.setAttribute("aria-hidden", "true");
    this.#move = this.#handle("plane-move", (event, across, down) => this.#lead(event, across, down), (event) => this.#keyMove(event));
    this.#turn = this.#handle("plane-turn", (event, across, down) => this.#aim(event, across, down), (event) => this.#keyTurn(event));
    for (const one of [this.#line, this.#move, this.#turn]) {
      one.hidden = true;
      surface.append(one);
    }
    this.surface = surface;
  }

  /**
   * @param {string} name
   * @param {(event: PointerEvent, across: number, down: number) => void} drag
   * @param {(event: KeyboardEvent) => boolean} key whether it was of use
   */
  #handle(name, drag, key) {
    const made = document.createElement("div");
    made.className = `plane-handle ${name}`;
    made.id = name;
    made.tabIndex = 0;
    made.setAttribute("role", "slider");
    made.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      event.stopPropagation();
      event.preventDefault();
      made.focus();
      made.setPointerCapture(event.pointerId);
      this.#last = { x: event.clientX, y: event.clientY };
    });
    made.addEventListener("pointermove", (event) => {
      event.stopPropagation();
      if (this.#last === null || !made.hasPointerCapture(event.pointerId)) return;
      drag(event, event.clientX - this.#last.x, event.clientY - this.#last.y);
      this.#last = { x: event.clientX, y: event.clientY };
    });
    for (const end of /** @type {const} */ (["pointerup", "pointercancel", "lostpointercapture"])) {
      made.addEventListener(end, (event) => {
        event.stopPropagation();
        this.#last = null;
      });
    }
    made.addEventListener("wheel", (event) => {
      event.preventDefault();
      event.stopPropagation();
      this.plane.move(-Math.sign(event.deltaY || event.deltaX) * STEP_MM);
    }, { passive: false });
    made.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || !key(event)) return;
      event.preventDefault();
      event.stopPropagation();
    });
    return made;
  }

  /** Bring them to where the plane is seen. Call it after each picture, or whenever plane or camera are others. */
  place() {
    const { plane, camera } = this;
    for (const one of [this.#line, this.#move, this.#turn]) one.hidden = !plane.isOn;
    if (!plane.isOn) return;
    const [x, y] = camera.pixel(plane.point);
    const [ex, ey] = camera.pixel(add(plane.point, plane.normal, this.#normalMm));
    const [left, top] = [clamped(x, camera.width), clamped(y, camera.height)];
    let [right, bottom] = [clamped(ex, camera.width), clamped(ey, camera.height)];
    // seen along the normal they would cover each other
    if (Math.hypot(right - left, bottom - top) < APART_PIXELS) [right, bottom] = [left + (left > camera.width / 2 ? -1 : 1) * APART_PIXELS, top];
    Object.assign(this.#move.style, { left: `${left}px`, top: `${top}px` });
    Object.assign(this.#turn.style, { left: `${right}px`, top: `${bottom}px` });
    const [across, down] = [right - left, bottom - top];
    Object.assign(this.#line.style, {
      left: `${left}px`, top: `${top}px`, width: `${Math.hypot(across, down)}px`, transform: `rotate(${Math.atan2(down, across)}rad)`,
    });
    this.#tell();
  }

  get #normalMm() {
    return NORMAL_PIXELS * this.camera.mmPerPixel;
  }

  #tell() {
    const { plane } = this;
    const [least, most] = plane.range;
    const depth = plane.depth;
    const [toLeft, toBack, toHead] = plane.normal;
    for (const one of [this.#move, this.#turn]) {
      one.setAttribute("aria-label", say(one === this.#move ? "section_move" : "section_turn"));
      one.title = one.getAttribute("aria-label") ?? "";
    }
    this.#move.setAttribute("aria-valuemin", least.toFixed(0));
    this.#move.setAttribute("aria-valuemax", most.toFixed(0));
    this.#move.setAttribute("aria-valuenow", depth.toFixed(1));
    this.#move.setAttribute("aria-valuetext", say("section_at", { mm: figure(depth, 0) }));
    const elevation = Math.round((Math.asin(Math.min(Math.max(toHead, -1), 1)) * 180) / Math.PI);
    const around = Math.round((Math.atan2(toLeft, -toBack) * 180) / Math.PI);
    this.#turn.setAttribute("aria-valuemin", "-180");
    this.#turn.setAttribute("aria-valuemax", "180");
    this.#turn.setAttribute("aria-valuenow", String(around));
    this.#turn.setAttribute("aria-valuetext", say("section_turned", { around, up: elevation }));
  }

  /** @param {PointerEvent} _ @param {number} across @param {number} down */
  #lead(_, across, down) {
    const { camera, plane } = this;
    const seen = [dot(plane.normal, camera.right), -dot(plane.normal, camera.up)];
    const aside = Math.hypot(...seen);
    // seen along its normal: up the screen is away from the eye
    if (aside < ASIDE) plane.move(-Math.sign(dot(plane.normal, camera.towards)) * -down * camera.mmPerPixel);
    else plane.move(((across * seen[0] + down * seen[1]) / aside) * camera.mmPerPixel);
  }

  /** The normal's end goes with the pointer. @param {PointerEvent} _ @param {number} across @param {number} down */
  #aim(_, across, down) {
    const { camera, plane } = this;
    const way = add(add([0, 0, 0], camera.right, across / NORMAL_PIXELS), camera.up, -down / NORMAL_PIXELS);
    const axis = cross(plane.normal, way);
    const angle = Math.hypot(...axis);
    if (angle > 0) plane.turn(unit(axis), angle);
  }

  /** @param {KeyboardEvent} event */
  #keyMove(event) {
    const way = { ArrowUp: STEP_MM, ArrowRight: STEP_MM, ArrowDown: -STEP_MM, ArrowLeft: -STEP_MM, PageUp: PAGE_MM, PageDown: -PAGE_MM }[event.key];
    const [least, most] = this.plane.range;
    if (way !== undefined) this.plane.move(way);
    else if (event.key === "Home") this.plane.move(least - this.plane.depth);
    else if (event.key === "End") this.plane.move(most - this.plane.depth);
    else return false;
    return true;
  }

  /** Arrows turn it as they are seen. @param {KeyboardEvent} event */
  #keyTurn(event) {
    const { camera, plane } = this;
    const step = event.shiftKey ? TURN / 5 : TURN;
    /** @type {Record<string, [Vector, number]>} */
    const ways = {
      ArrowLeft: [camera.up, -step], ArrowRight: [camera.up, step], ArrowUp: [camera.right, -step], ArrowDown: [camera.right, step],
      PageUp: [camera.towards, step], PageDown: [camera.towards, -step],
    };
    const way = ways[event.key];
    if (way === undefined) return false;
    plane.turn(...way);
    return true;
  }
}

/** Over a picture of the heart: letters of the patient's sides, as radiologists write them, and how long a millimetre is. */

import { SIDES } from "../section/plane.js";

/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./camera.js").Vector} Vector */
/** @typedef {"front" | "back" | "left" | "right" | "head" | "feet"} Side */
/** @typedef {(text: string, x: number, y: number, align: CanvasTextAlign, line: CanvasTextBaseline) => void} Write */
/** @typedef {{pen: CanvasRenderingContext2D, ink: string, paper: string, write: Write}} Drawing */

const INSET = 8;
/** Below the buttons over a view. */
const BELOW_BUTTONS = 46;
const LENGTHS_MM = [1, 2, 5, 10, 20, 50, 100, 200];
const SCALE_PART = 0.25;
/** A side counts from this part of a direction on. */
const LEAST = 0.35;
/** Sides that the axes of LPS lead to and come from. @type {readonly (readonly [Side, Side])[]} */
const WAYS = /** @type {any} */ (
  [0, 1, 2].map((axis) => [1, -1].map((sign) => Object.keys(SIDES).find((side) => SIDES[side][axis] === sign)))
);
/** As in the studio: left, right, posterior, anterior, head, feet. @type {Record<Side, string>} */
const LETTERS = { left: "L", right: "R", back: "P", front: "A", head: "H", feet: "F" };

/** Sides of the patient that a direction leads to, the strongest first; weak ones are left out. @param {Vector} direction @returns {Side[]} */
export function sidesOf(direction) {
  const size = Math.hypot(...direction);
  return [0, 1, 2]
    .filter((axis) => Math.abs(direction[axis]) >= LEAST * size)
    .sort((a, b) => Math.abs(direction[b]) - Math.abs(direction[a]))
    .map((axis) => WAYS[axis][direction[axis] > 0 ? 0 : 1]);
}

/** With a dot between two, as RA beside a heart is its right atrium. @param {Vector} direction */
export const lettersOf = (direction) => sidesOf(direction).map((side) => LETTERS[side]).join("·");

/**
 * Draw them anew; with what more can be drawn.
 * @param {HTMLCanvasElement} canvas @param {Camera} camera @param {number} [top] where the upper letter begins, CSS pixels
 * @returns {Drawing}
 */
export function drawOrientation(canvas, camera, top = INSET) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const [width, height] = [Math.round(camera.width * ratio), Math.round(camera.height * ratio)];
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, camera.width, camera.height);
  const style = getComputedStyle(canvas);
  const [ink, paper] = [style.getPropertyValue("--ink"), style.getPropertyValue("--paper")];
  /** @type {Write} */
  const write = (text, x, y, align, line) => {
    Object.assign(pen, { textAlign: align, textBaseline: line, lineWidth: 4, lineJoin: "round", strokeStyle: paper, fillStyle: ink });
    pen.strokeText(text, x, y);
    pen.fillText(text, x, y);
  };
  pen.font = "600 15px system-ui, sans-serif";
  const back = (/** @type {Vector} */ way) => /** @type {Vector} */ (way.map((part) => -part));
  write(lettersOf(camera.right), camera.width - INSET, camera.height / 2, "right", "middle");
  write(lettersOf(back(camera.right)), INSET, camera.height / 2, "left", "middle");
  write(lettersOf(camera.up), camera.width / 2, top, "center", "top");
  write(lettersOf(back(camera.up)), camera.width / 2, camera.height - INSET, "center", "bottom");
  // at the middle of what is seen
  const room = SCALE_PART * camera.width * camera.mmPerPixel;
  const length = LENGTHS_MM.filter((mm) => mm <= room).at(-1) ?? LENGTHS_MM[0];
  const bottom = camera.height - 14;
  pen.fillStyle = ink;
  pen.fillRect(12, bottom, length / camera.mmPerPixel, 3);
  write(`${length} mm`, 12, bottom - 4, "left", "bottom");
  return { pen, ink, paper, write };
}

/** The same over a view, drawn where it is another than before. */
export class Orientation {
  #drawn = "";

  /** @param {HTMLElement} surface of the view @param {Camera} camera */
  constructor(surface, camera) {
    this.surface = surface;
    this.canvas = /** @type {HTMLCanvasElement} */ (surface.querySelector("canvas.orientation"));
    this.camera = camera;
  }

  draw() {
    if (this.surface.hidden) return;
    const { right, up, mmPerPixel, width, height } = this.camera;
    const shown = JSON.stringify([right, up, mmPerPixel, width, height, document.documentElement.dataset.theme, devicePixelRatio]);
    if (shown === this.#drawn) return;
    this.#drawn = shown;
    drawOrientation(this.canvas, this.camera, BELOW_BUTTONS);
  }
}

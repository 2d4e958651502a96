/** What is drawn over the picture: letters of the patient's sides, a scale, landmarks and planned incisions with their names. */

import { dot } from "../operating/camera.js";
import { figure, say } from "../shared/words.js";
import { lettersOf } from "./looking.js";

/** @typedef {import("../operating/camera.js").Camera} Camera */
/** @typedef {import("../operating/camera.js").Vector} Vector */
/** @typedef {{name: string, kind: string, closed: boolean, depth: number | null, points: Vector[]}} Mark */
/** @typedef {(text: string, x: number, y: number, align: CanvasTextAlign, line: CanvasTextBaseline) => void} Write */

const INSET = 8;
const LENGTHS_MM = [1, 2, 5, 10, 20, 50, 100, 200];
const SCALE_PART = 0.25;
const LINE_PX = 15;
/** A landmark is drawn to this far before a plane that cuts, mm. */
const BEFORE_MM = 2;

export class Marks {
  /** @type {readonly Mark[]} */
  marks = [];
  areShown = true;
  /** Plane before which nothing is drawn: normal, and how far it is from the origin. @type {[number, number, number, number] | null} */
  cut = null;

  /** @param {HTMLCanvasElement} canvas @param {Camera} camera */
  constructor(canvas, camera) {
    this.canvas = canvas;
    this.camera = camera;
  }

  draw() {
    const { canvas, camera } = this;
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
    write(lettersOf(camera.up), camera.width / 2, INSET, "center", "top");
    write(lettersOf(back(camera.up)), camera.width / 2, camera.height - INSET, "center", "bottom");
    this.#scale(pen, ink, write);
    if (!this.areShown) return;
    pen.font = "500 13px system-ui, sans-serif";
    /** @type {{left: number, top: number, wide: number}[]} */
    const taken = [];
    for (const mark of this.marks) this.#mark(pen, ink, paper, write, mark, taken);
  }

  /** How long a millimetre is at the middle of what is seen. @param {CanvasRenderingContext2D} pen @param {string} ink @param {Write} write */
  #scale(pen, ink, write) {
    const { camera } = this;
    const room = SCALE_PART * camera.width * camera.mmPerPixel;
    const length = LENGTHS_MM.filter((mm) => mm <= room).at(-1) ?? LENGTHS_MM[0];
    const bottom = camera.height - 14;
    pen.fillStyle = ink;
    pen.fillRect(12, bottom, length / camera.mmPerPixel, 3);
    write(`${length} mm`, 12, bottom - 4, "left", "bottom");
  }

  /** @param {CanvasRenderingContext2D} pen @param {string} ink @param {string} paper @param {Write} write @param {Mark} mark @param {{left: number, top: number, wide: number}[]} taken */
  #mark(pen, ink, paper, write, mark, taken) {
    const { cut, camera } = this;
    if (cut && mark.points.every((point) => dot(/** @type {any} */ (cut.slice(0, 3)), point) > cut[3] + BEFORE_MM)) return;
    const points = mark.points.map((point) => camera.pixel(point));
    Object.assign(pen, { lineJoin: "round", lineCap: "round" });
    pen.beginPath();
    if (points.length === 1) {
      pen.arc(points[0][0], points[0][1], 5, 0, 2 * Math.PI);
      Object.assign(pen, { fillStyle: paper, lineWidth: 2.5, strokeStyle: ink });
      pen.fill();
      pen.stroke();
    } else {
      points.forEach(([x, y], n) => (n ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      if (mark.closed) pen.closePath();
      const isIncision = mark.kind === "incision";
      for (const [wide, colour, dashes] of /** @type {[number, string, number[]][]} */ ([[isIncision ? 7 : 6, paper, []], [isIncision ? 3.5 : 2.5, ink, isIncision ? [9, 6] : []]])) {
        Object.assign(pen, { lineWidth: wide, strokeStyle: colour });
        pen.setLineDash(dashes);
        pen.stroke();
      }
      pen.setLineDash([]);
    }
    const [x, y] = points[mark.closed ? 0 : points.length - 1];
    const words = mark.depth === null ? mark.name : `${mark.name}, ${say("offline_deep", { mm: figure(mark.depth, 0) })}`;
    const wide = pen.measureText(words).width;
    const left = x + 9 + wide < camera.width ? x + 9 : x - 9 - wide;
    const room = [0, 1, -1, 2, -2, 3, -3].map((step) => ({ left, top: y + (step - 0.5) * LINE_PX }));
    const isFree = (/** @type {{left: number, top: number}} */ one) =>
      taken.every((other) => one.left > other.left + other.wide || other.left > one.left + wide || Math.abs(one.top - other.top) >= LINE_PX);
    const place = room.find(isFree) ?? room[0];
    taken.push({ ...place, wide });
    write(words, place.left, place.top + LINE_PX / 2, "left", "middle");
  }
}

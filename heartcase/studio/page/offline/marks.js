/** What is drawn over the picture: letters of the patient's sides, a scale, landmarks and planned incisions with their names. */

import { dot } from "../operating/camera.js";
import { drawOrientation } from "../operating/orientation.js";
import { figure, say } from "../shared/words.js";

/** @typedef {import("../operating/camera.js").Camera} Camera */
/** @typedef {import("../operating/camera.js").Vector} Vector */
/** `torn` are the numbers of points before which the line has no piece. @typedef {{name: string, kind: string, closed: boolean, depth: number | null, points: Vector[], torn?: ReadonlySet<number>}} Mark */
/** @typedef {import("../operating/orientation.js").Write} Write */

const LINE_PX = 15;
/** A landmark is drawn to this far before a plane that cuts, mm. */
const BEFORE_MM = 2;
/** A piece of a line that is longer than so many times what it was, and so many mm, goes from one lip of an incision to the other. */
const TORN = 1.4;
const TORN_MM = 0.5;

/**
 * Points of a line before which it is torn: its neighbours went with other lips of an incision.
 * @param {readonly Vector[]} rest @param {readonly Vector[]} now @param {boolean} isClosed @returns {Set<number>}
 */
export function tornBefore(rest, now, isClosed) {
  const apart = (/** @type {readonly Vector[]} */ points, /** @type {number} */ n) => {
    const [one, other] = [points[n], points[(n || points.length) - 1]];
    return Math.hypot(one[0] - other[0], one[1] - other[1], one[2] - other[2]);
  };
  return new Set([...rest.keys()].filter((n) => (n || isClosed) && apart(now, n) > TORN * apart(rest, n) + TORN_MM));
}

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
    const { pen, ink, paper, write } = drawOrientation(this.canvas, this.camera);
    if (!this.areShown) return;
    pen.font = "500 13px system-ui, sans-serif";
    /** @type {{left: number, top: number, wide: number}[]} */
    const taken = [];
    for (const mark of this.marks) this.#mark(pen, ink, paper, write, mark, taken);
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
      const { torn } = mark;
      points.forEach(([x, y], n) => (n && !torn?.has(n) ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      if (mark.closed && !torn?.size) pen.closePath();
      else if (mark.closed && !torn?.has(0)) pen.lineTo(points[0][0], points[0][1]);
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

/** Rulers and angles: lengths and angles of what is seen. They are the page's alone, and gone when it is closed. */

import { Signal } from "../../shared/signal.js";

/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {{kind: "ruler" | "angle", points: Vector[]}} Measure */

const POINTS = { ruler: 2, angle: 3 };

export class Measures {
  /** Grows with every change. @type {Signal<number>} */
  changed = new Signal(0);
  /** @type {Measure[]} */
  all = [];
  /** The one that lacks points yet; its last point follows the pointer. @type {Measure | null} */
  open = null;

  /** A point was set. @param {"ruler" | "angle"} kind @param {Vector} mm */
  set(kind, mm) {
    if (this.open !== null && this.open.kind !== kind) this.drop();
    if (this.open === null) {
      this.open = { kind, points: [mm, mm] };
      this.all.push(this.open);
    } else {
      this.open.points[this.open.points.length - 1] = mm;
      if (this.open.points.length === POINTS[kind]) this.open = null;
      else this.open.points.push(mm);
    }
    this.changed.value += 1;
  }

  /** The pointer moved. @param {Vector} mm */
  follow(mm) {
    if (this.open === null) return;
    this.open.points[this.open.points.length - 1] = mm;
    this.changed.value += 1;
  }

  /** Leave out the one that is not finished. */
  drop() {
    if (this.open === null) return false;
    this.all = this.all.filter((one) => one !== this.open);
    this.open = null;
    this.changed.value += 1;
    return true;
  }

  /** Remove the last one. */
  removeLast() {
    if (this.drop() || this.all.length === 0) return;
    this.all.pop();
    this.changed.value += 1;
  }
}

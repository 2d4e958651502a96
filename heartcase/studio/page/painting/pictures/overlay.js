/** What lies over a slice: crosshair, brush, the stroke under way, measurements, scale bar and letters. */

import { figure } from "../../shared/words.js";
import { handlesOf, lineOf, VIEWS } from "./planes.js";
import { angleDegrees, distance, orientationLetters, plus, roundLength, sectionRadius } from "../../shared/geometry.js";

/** @typedef {import("../../shared/geometry.js").Camera} Camera */
/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../tools/measures.js").Measure} Measure */

/** Light lines keep their contrast on white tissue through a dark rim. */
const RIM = "rgba(0, 0, 0, 0.75)";
const LIGHT = "#f4f6f8";
const CROSSHAIR = "#7fd4ff";
const RULER = "#ffe27a";
const GAP = 12;
const ODD_MARK = "#ffcf66";
/** Openings this far from a slice are marked in it. */
const MARK_DEPTH_MM = 2;

/**
 * @param {CanvasRenderingContext2D} pen in CSS pixels
 * @param {import("./planes.js").ViewName} name
 * @param {Camera} camera
 * @param {Studio} studio
 * @param {readonly Measure[]} measures
 */
export function drawOverlay(pen, name, camera, studio, measures) {
  pen.clearRect(0, 0, camera.width, camera.height);
  const through = studio.crosshair.value;
  drawStroke(pen, camera, through, studio);
  drawCrosshair(pen, name, camera, studio);
  for (const measure of measures) drawMeasure(pen, camera, through, measure, studio.lattice.value?.sliceStep(camera.frame.normal) ?? 1);
  for (const mark of studio.marks.value) drawMark(pen, camera, through, mark, studio.lattice.value?.sliceStep(camera.frame.normal) ?? 1);
  drawBrush(pen, camera, through, studio);
  drawLetters(pen, camera);
  drawScale(pen, camera);
}

/**
 * What lies over the solids: letters, scale, and where the slices meet.
 * @param {CanvasRenderingContext2D} pen in CSS pixels
 * @param {Camera} camera
 * @param {Vector} through
 */
export function drawSolidOverlay(pen, camera, through) {
  pen.clearRect(0, 0, camera.width, camera.height);
  const { x, y } = camera.toPixel(through, through);
  rimmed(pen, CROSSHAIR, () => pen.arc(x, y, 6, 0, 2 * Math.PI), 1.5);
  drawLetters(pen, camera);
  drawScale(pen, camera);
}

/** @param {CanvasRenderingContext2D} pen @param {string} colour @param {() => void} path */
export function rimmed(pen, colour, path, width = 1.25) {
  for (const [style, wide] of /** @type {const} */ ([[RIM, width + 2], [colour, width]])) {
    pen.strokeStyle = style;
    pen.lineWidth = wide;
    pen.beginPath();
    path();
    pen.stroke();
  }
}

/** @param {CanvasRenderingContext2D} pen @param {string} text @param {number} x @param {number} y @param {string} colour */
export function lettering(pen, text, x, y, colour = LIGHT) {
  pen.lineJoin = "round";
  pen.strokeStyle = RIM;
  pen.lineWidth = 3;
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}

/** Lines where the other slices are, and with the pointer in hand the handles that turn them. @param {CanvasRenderingContext2D} pen @param {import("./planes.js").ViewName} name @param {Camera} camera @param {Studio} studio */
function drawCrosshair(pen, name, camera, studio) {
  const through = studio.crosshair.value;
  const { x, y } = camera.toPixel(through, through);
  const planes = studio.planes.value;
  const far = camera.width + camera.height + Math.abs(x) + Math.abs(y);
  rimmed(pen, CROSSHAIR, () => {
    for (const other of VIEWS) {
      const line = other === name ? null : lineOf(camera.frame, planes.frames[other]);
      if (line === null) continue;
      for (const way of [1, -1]) {
        pen.moveTo(x + way * GAP * line[0], y + way * GAP * line[1]);
        pen.lineTo(x + way * far * line[0], y + way * far * line[1]);
      }
    }
  }, 1);
  if (studio.tool.value !== "pointer") return;
  for (const at of handlesOf(planes, name, camera, { x, y })) rimmed(pen, CROSSHAIR, () => pen.arc(at.x, at.y, 6, 0, 2 * Math.PI), 2);
}

/** @param {CanvasRenderingContext2D} pen @param {Camera} camera @param {Vector} through @param {Studio} studio */
function drawBrush(pen, camera, through, studio) {
  const hover = studio.hover.value;
  const tool = studio.tool.value;
  if (hover === null || studio.panning.value || (tool !== "brush" && tool !== "eraser")) return;
  const { x, y, depth } = camera.toPixel(hover.mm, through);
  const radius = sectionRadius(studio.radiusMm.value, depth) / camera.mmPerPixel;
  if (radius < 0.5) return;
  const colour = studio.erases ? LIGHT : (studio.pickedLabel?.colour ?? LIGHT);
  pen.setLineDash(studio.erases ? [5, 4] : []);
  rimmed(pen, studio.erases ? LIGHT : lighter(colour), () => pen.arc(x, y, radius, 0, 2 * Math.PI), 1.5);
  pen.setLineDash([]);
}

/** A structure's colour light enough to be seen on the dark rim. @param {string} colour */
export function lighter(colour) {
  const rgb = parseInt(colour.slice(1), 16);
  const parts = [(rgb >> 16) & 255, (rgb >> 8) & 255, rgb & 255];
  const share = Math.max(...parts) < 170 || parts[0] + parts[1] + parts[2] < 300 ? 0.5 : 0;
  return `rgb(${parts.map((part) => Math.round(part + (255 - part) * share)).join(", ")})`;
}

/** A light rim around what was gone over: the labels come from the server. @param {CanvasRenderingContext2D} pen @param {Camera} camera @param {Vector} through @param {Studio} studio */
function drawStroke(pen, camera, through, studio) {
  const stroke = studio.stroke.value;
  if (stroke === null) return;
  const radius = studio.radiusMm.value;
  /** @type {{x: number, y: number, r: number}[]} */
  const discs = [];
  stroke.points.forEach((point, n) => {
    const before = stroke.points[Math.max(n - 1, 0)];
    const count = Math.min(Math.max(Math.ceil(distance(before, point) / (radius / 3)), 1), 200);
    for (let step = 1; step <= count; step++) {
      const at = camera.toPixel(plus(before, plus(point, before, -1), step / count), through);
      const r = sectionRadius(radius, at.depth) / camera.mmPerPixel;
      if (r > 0.5) discs.push({ x: at.x, y: at.y, r });
    }
  });
  for (const [mode, less] of /** @type {const} */ ([["source-over", 0], ["destination-out", 1.5]])) {
    pen.globalCompositeOperation = mode;
    pen.fillStyle = LIGHT;
    for (const { x, y, r } of discs) {
      if (r <= less) continue;
      pen.beginPath();
      pen.arc(x, y, r - less, 0, 2 * Math.PI);
      pen.fill();
    }
  }
  pen.globalCompositeOperation = "source-over";
}

/** @param {CanvasRenderingContext2D} pen @param {Camera} camera @param {Vector} through @param {Measure} measure @param {number} thickness of a slice, mm */
function drawMeasure(pen, camera, through, measure, thickness) {
  const pixels = measure.points.map((point) => camera.toPixel(point, through));
  if (pixels.some(({ depth }) => Math.abs(depth) > thickness / 2 + 1e-6)) return;
  rimmed(pen, RULER, () => pixels.forEach(({ x, y }, n) => (n ? pen.lineTo(x, y) : pen.moveTo(x, y))), 1.5);
  for (const { x, y } of pixels) rimmed(pen, RULER, () => pen.arc(x, y, 3, 0, 2 * Math.PI), 1.5);
  const text = measureText(measure);
  if (text === "") return;
  const corner = pixels[measure.kind === "angle" ? 1 : pixels.length - 1];
  pen.font = "600 13px system-ui, sans-serif";
  pen.textAlign = corner.x > camera.width - 70 ? "right" : "left";
  pen.textBaseline = "middle";
  lettering(pen, text, corner.x + (pen.textAlign === "left" ? 9 : -9), corner.y, RULER);
}

/**
 * An opening of the case: an arrow onto its middle, where the slice goes through it.
 * @param {CanvasRenderingContext2D} pen @param {Camera} camera @param {Vector} through
 * @param {{mm: Vector, text: string, isOdd: boolean}} mark @param {number} thickness
 */
function drawMark(pen, camera, through, { mm, text, isOdd }, thickness) {
  const { x, y, depth } = camera.toPixel(mm, through);
  if (Math.abs(depth) > Math.max(thickness / 2, MARK_DEPTH_MM)) return;
  const colour = isOdd ? ODD_MARK : LIGHT;
  rimmed(pen, colour, () => {
    pen.moveTo(x + 22, y - 22);
    pen.lineTo(x + 3, y - 3);
    pen.moveTo(x + 3, y - 11);
    pen.lineTo(x + 3, y - 3);
    pen.lineTo(x + 11, y - 3);
  }, 1.75);
  pen.font = "600 13px system-ui, sans-serif";
  pen.textAlign = "left";
  pen.textBaseline = "middle";
  lettering(pen, text, x + 25, y - 24, colour);
}

/** What a measurement says: "12.3 mm" or "45.0 degrees"; nothing while it lacks points. @param {Measure} measure */
export function measureText({ kind, points }) {
  if (kind === "ruler" && points.length === 2) return `${figure(distance(points[0], points[1]), 1)} mm`;
  if (kind === "angle" && points.length === 3) return `${figure(angleDegrees(points[0], points[1], points[2]), 1)}°`;
  return "";
}

/**
 * What the sides of a view face.
 * @param {Camera} camera
 * @returns {{left: string, right: string, top: string, bottom: string}}
 */
export function sidesOf({ frame: { right, down } }) {
  /** @param {Vector} v @returns {Vector} */
  const back = (v) => [-v[0], -v[1], -v[2]];
  return {
    left: orientationLetters(back(right)),
    right: orientationLetters(right),
    top: orientationLetters(back(down)),
    bottom: orientationLetters(down),
  };
}

/** @param {CanvasRenderingContext2D} pen @param {Camera} camera */
function drawLetters(pen, camera) {
  const { width, height } = camera;
  const { left, right, top, bottom } = sidesOf(camera);
  pen.font = "600 14px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.textAlign = "left";
  lettering(pen, left, 7, height / 2);
  pen.textAlign = "right";
  lettering(pen, right, width - 7, height / 2);
  pen.textAlign = "center";
  lettering(pen, top, width / 2, 13);
  lettering(pen, bottom, width / 2, height - 13);
}

/** @param {CanvasRenderingContext2D} pen @param {Camera} camera */
function drawScale(pen, { mmPerPixel, width, height }) {
  const length = roundLength(Math.min(width * 0.25, 160) * mmPerPixel);
  const pixels = length / mmPerPixel;
  const [x, y] = [10, height - 12];
  rimmed(pen, LIGHT, () => {
    pen.moveTo(x, y - 4);
    pen.lineTo(x, y);
    pen.lineTo(x + pixels, y);
    pen.lineTo(x + pixels, y - 4);
  }, 1.5);
  pen.font = "12px system-ui, sans-serif";
  pen.textAlign = "left";
  pen.textBaseline = "bottom";
  lettering(pen, `${figure(length, length < 1 ? 1 : 0)} mm`, x, y - 5);
}

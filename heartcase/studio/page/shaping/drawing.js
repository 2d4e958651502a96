/** The lines of the recipe over the slices and the solids: discs, paths and points, where a slice meets them. */

import { dot, plus, sectionRadius } from "../shared/geometry.js";
import { lighter, rimmed, lettering } from "../painting/pictures/overlay.js";
import { structureName } from "../shared/words.js";
import { kindWord } from "./form.js";
import { cutOf, rimOf, unit, within } from "./discs.js";
import { discOf, isSame, kindOf } from "./shaping.js";

/** @typedef {import("../shared/geometry.js").Camera} Camera */
/** @typedef {import("../shared/geometry.js").Vector} Vector */
/** @typedef {import("./shaping.js").Entry} Entry */
/** @typedef {import("./shaping.js").Line} Line */
/** @typedef {import("./shaping.js").List} List */
/** @typedef {import("./shaping.js").Shaping} Shaping */
/** @typedef {{line: Line, at: "centre" | "rim", mm: Vector}} Handle */

/** @type {readonly List[]} */
export const DRAWN = ["ends", "edits", "landmarks", "pins"];

/** @type {Record<string, string>} */
const COLOURS = { ends: "#ffe27a", septal_defect: "#ff9fd0", close_defect: "#9df0b0", point: "#9fe3ff", ring: "#9fe3ff", polyline: "#9fe3ff", pins: "#d6c5ff" };
const PICKED = "#ffffff";
const OFF = "#a8b0b8";
const RIM_POINTS = 48;

/** @param {List} list @param {Entry} entry @param {Shaping} shaping */
function colourOf(list, entry, shaping) {
  if (entry.enabled === false) return OFF;
  const known = COLOURS[kindOf(list, entry)];
  const colour = shaping.shape.value?.structures.find((one) => one.name === entry.label)?.colour;
  return known ?? (colour ? lighter(colour) : PICKED);
}

/**
 * Draw the lines over a slice.
 * @param {CanvasRenderingContext2D} pen in CSS pixels
 * @param {Camera} camera
 * @param {Vector} through
 * @param {number} thickness of a slice, mm
 * @param {Shaping} shaping
 */
export function drawLines(pen, camera, through, thickness, shaping) {
  if (!shaping.isOpen.value) return;
  for (const { line, entry } of shaping.lines(DRAWN)) {
    const isPicked = isSame(line, shaping.selected.value) || line.number === 0;
    const colour = colourOf(line.list, entry, shaping);
    const disc = discOf(line.list, entry);
    if (line.list === "pins") drawBall(pen, camera, through, entry.position_mm, entry.radius_mm, colour, isPicked);
    else if (disc) drawDisc(pen, camera, through, thickness, line, entry, disc, colour, isPicked);
    else if (entry.points_mm) drawPath(pen, camera, through, thickness, line, entry, colour, isPicked);
  }
}

/** @param {CanvasRenderingContext2D} pen @param {Camera} camera @param {Vector} through @param {Vector} mm @param {number} radiusMm @param {string} colour @param {boolean} isPicked */
function drawBall(pen, camera, through, mm, radiusMm, colour, isPicked) {
  const { x, y, depth } = camera.toPixel(mm, through);
  const radius = sectionRadius(radiusMm, depth) / camera.mmPerPixel;
  if (radius > 0.5) rimmed(pen, colour, () => pen.arc(x, y, radius, 0, 2 * Math.PI), isPicked ? 2.5 : 1.25);
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Camera} camera
 * @param {Vector} through
 * @param {number} thickness
 * @param {Line} line
 * @param {Entry} entry
 * @param {import("./discs.js").Disc} disc
 * @param {string} colour
 * @param {boolean} isPicked
 */
function drawDisc(pen, camera, through, thickness, line, entry, disc, colour, isPicked) {
  const cut = cutOf(disc, camera.frame, through, thickness);
  const outline = rimOf(disc, RIM_POINTS).map((mm) => camera.toPixel(mm, through));
  const round = () => outline.forEach(({ x, y }, n) => (n ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  // What lies in another slice is only hinted at.
  if (isPicked && cut?.kind !== "circle") {
    pen.setLineDash([3, 4]);
    rimmed(pen, colour, () => { round(); pen.closePath(); }, 0.75);
    pen.setLineDash([]);
  }
  if (cut === null) return;
  const centre = camera.toPixel(disc.centre, through);
  const width = isPicked ? 3 : 1.75;
  if (cut.kind === "circle") rimmed(pen, colour, () => { round(); pen.closePath(); }, width);
  else {
    const [a, b] = cut.ends.map((mm) => camera.toPixel(mm, through));
    rimmed(pen, colour, () => { pen.moveTo(a.x, a.y); pen.lineTo(b.x, b.y); }, width);
    drawDirection(pen, camera, line, entry, disc, colour, { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 });
  }
  if (!isPicked) return;
  rimmed(pen, PICKED, () => pen.arc(centre.x, centre.y, 4, 0, 2 * Math.PI), 1.5);
  for (const { mm } of rimHandles(disc, camera, through, thickness)) {
    const { x, y } = camera.toPixel(mm, through);
    rimmed(pen, PICKED, () => pen.rect(x - 3.5, y - 3.5, 7, 7), 1.5);
  }
  pen.font = "600 13px system-ui, sans-serif";
  pen.textAlign = "left";
  pen.textBaseline = "bottom";
  lettering(pen, nameOf(line, entry), Math.min(centre.x + 8, camera.width - 90), centre.y - 8, colour);
}

/** The way out of the heart, or the canal through a septum. @param {CanvasRenderingContext2D} pen @param {Camera} camera @param {Line} line @param {Entry} entry
 * @param {import("./discs.js").Disc} disc @param {string} colour @param {{x: number, y: number}} from */
function drawDirection(pen, camera, line, entry, disc, colour, from) {
  const along = within(unit(disc.axis), camera.frame);
  const [dx, dy] = [dot(along, camera.frame.right), dot(along, camera.frame.down)];
  const isEnd = line.list === "ends";
  const isDefect = entry.kind === "septal_defect" || entry.kind === "close_defect";
  const length = (isEnd ? disc.radius : isDefect ? (entry.length_mm ?? entry.thickness_mm ?? (entry.kind === "septal_defect" ? 20 : 2)) / 2 : 0) / camera.mmPerPixel;
  if (length * Math.hypot(dx, dy) < 3) return;
  const [x, y] = [from.x + dx * length, from.y + dy * length];
  rimmed(pen, colour, () => {
    pen.moveTo(isEnd ? from.x : 2 * from.x - x, isEnd ? from.y : 2 * from.y - y);
    pen.lineTo(x, y);
    if (!isEnd) return;
    // an arrow's head
    const size = 7 / Math.hypot(dx, dy);
    pen.moveTo(x - (dx + 0.6 * dy) * size, y - (dy - 0.6 * dx) * size);
    pen.lineTo(x, y);
    pen.lineTo(x - (dx - 0.6 * dy) * size, y - (dy + 0.6 * dx) * size);
  }, 1.25);
}

/** @param {CanvasRenderingContext2D} pen @param {Camera} camera @param {Vector} through @param {number} thickness @param {Line} line @param {Entry} entry @param {string} colour @param {boolean} isPicked */
function drawPath(pen, camera, through, thickness, line, entry, colour, isPicked) {
  const radius = line.list === "edits" ? entry.radius_mm : 0;
  const points = /** @type {Vector[]} */ (entry.points_mm).map((mm) => camera.toPixel(mm, through));
  const near = points.map(({ depth }) => Math.abs(depth) <= Math.max(radius, thickness / 2) + 1e-6);
  const width = isPicked ? 2.5 : 1.5;
  rimmed(pen, colour, () => points.forEach(({ x, y }, n) => {
    if (n > 0 && near[n] && near[n - 1]) {
      pen.moveTo(points[n - 1].x, points[n - 1].y);
      pen.lineTo(x, y);
    }
  }), width);
  points.forEach(({ x, y, depth }, n) => {
    if (!near[n]) return;
    const isOuter = n === 0 || n === points.length - 1;
    if (isOuter) rimmed(pen, colour, () => pen.arc(x, y, 3, 0, 2 * Math.PI), width);
    if (radius > 0 && isOuter) {
      pen.setLineDash([4, 3]);
      rimmed(pen, colour, () => pen.arc(x, y, Math.max(sectionRadius(radius, depth) / camera.mmPerPixel, 1), 0, 2 * Math.PI), 1);
      pen.setLineDash([]);
    }
  });
  const first = near.indexOf(true);
  // too many names would hide what is below
  if (first < 0 || (!isPicked && points.length > 1)) return;
  pen.font = "600 13px system-ui, sans-serif";
  pen.textAlign = "left";
  pen.textBaseline = "bottom";
  lettering(pen, nameOf(line, entry), Math.min(points[first].x + 8, camera.width - 90), points[first].y - 8, colour);
}

/** Draw the lines over the solids: discs as they lie. @param {CanvasRenderingContext2D} pen @param {Camera} camera @param {Vector} through @param {Shaping} shaping */
export function drawLinesOnSolid(pen, camera, through, shaping) {
  if (!shaping.isOpen.value) return;
  for (const { line, entry } of shaping.lines(DRAWN)) {
    const disc = discOf(line.list, entry);
    const points = disc ? [...rimOf(disc, RIM_POINTS), rimOf(disc, RIM_POINTS)[0]] : (entry.points_mm ?? []);
    const isPicked = isSame(line, shaping.selected.value);
    const pixels = /** @type {Vector[]} */ (points).map((mm) => camera.toPixel(mm, through));
    const width = isPicked ? 3 : 1.5;
    rimmed(pen, colourOf(line.list, entry, shaping), () => {
      if (pixels.length === 1) pen.arc(pixels[0].x, pixels[0].y, 3, 0, 2 * Math.PI);
      else pixels.forEach(({ x, y }, n) => (n ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    }, width);
  }
}

/** What a disc's rim can be taken at in a slice. @param {import("./discs.js").Disc} disc @param {Camera} camera @param {Vector} through @param {number} thickness @returns {{mm: Vector}[]} */
function rimHandles(disc, camera, through, thickness) {
  const cut = cutOf(disc, camera.frame, through, thickness);
  if (cut === null) return [];
  if (cut.kind === "line") return cut.ends.map((mm) => ({ mm }));
  const { right, down } = camera.frame;
  return [right, down].flatMap((way) => [1, -1].map((sign) => ({ mm: plus(disc.centre, way, sign * disc.radius) })));
}

/**
 * What of the lines is near a pixel: handles of the selected one first, then the middle of any.
 * @param {Shaping} shaping
 * @param {Camera} camera
 * @param {Vector} through
 * @param {number} thickness
 * @param {{x: number, y: number}} at
 * @param {number} reach pixels
 * @returns {Handle | null}
 */
export function handleAt(shaping, camera, through, thickness, at, reach) {
  const away = (/** @type {Vector} */ mm) => {
    const { x, y } = camera.toPixel(mm, through);
    return Math.hypot(x - at.x, y - at.y);
  };
  /** @type {{handle: Handle, away: number}[]} */
  const near = [];
  for (const { line, entry } of shaping.lines(DRAWN)) {
    const isPicked = isSame(line, shaping.selected.value);
    const disc = discOf(line.list, entry);
    /** @type {Handle[]} */
    const handles = [];
    if (disc && line.list !== "pins" && cutOf(disc, camera.frame, through, thickness)) {
      handles.push({ line, at: "centre", mm: disc.centre });
      if (isPicked) handles.push(...rimHandles(disc, camera, through, thickness).map(({ mm }) => ({ line, at: /** @type {"rim"} */ ("rim"), mm })));
    } else if (entry.points_mm || entry.position_mm) {
      for (const mm of entry.points_mm ?? [entry.position_mm]) {
        if (Math.abs(camera.toPixel(mm, through).depth) <= Math.max(entry.radius_mm ?? 0, thickness / 2) + 1e-6) handles.push({ line, at: "centre", mm });
      }
    }
    // of the one that is selected first
    for (const handle of handles) near.push({ handle, away: away(handle.mm) - (isPicked ? reach / 2 : 0) });
  }
  near.sort((a, b) => a.away - b.away);
  return near[0] && near[0].away <= reach ? near[0].handle : null;
}

/** What a line is called in the picture: its name, or what it is of. @param {Line} line @param {Entry} entry @returns {string} */
function nameOf(line, entry) {
  return entry.name ?? (entry.label ? structureName(entry.label) : kindWord(kindOf(line.list, entry)));
}

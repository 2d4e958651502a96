/** To a place with a structure picked and the brush in hand: what is done where a question about a place is answered with no. */

import { SMALLEST_RADIUS_MM } from "../studio.js";

/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../../shared/geometry.js").Vector} Vector */

/**
 * @param {Studio} studio
 * @param {import("../pictures/views.js").Views} views
 * @param {{value: number, mm: Vector, mostMm: number}} what value of the structure, the place, and the largest brush that fits there
 */
export function paintHere(studio, views, { value, mm, mostMm }) {
  // the tab gives the tool of painting back, where another one has its own
  /** @type {HTMLElement} */ (document.getElementById("tab-structures")).click();
  studio.pick(value);
  studio.take("brush");
  const radius = Math.max(Math.floor(10 * mostMm) / 10, SMALLEST_RADIUS_MM);
  if (studio.radiusMm.value > radius) studio.radiusMm.value = radius;
  if (studio.hidden.value.has(value)) studio.toggleShown(value);
  views.lookAt(mm);
  // by keys, too, one goes on in the slice: Enter paints there
  views.active.surface.focus({ preventScroll: true });
}

/**
 * What the wall between two structures is painted with: the muscle of their ventricle where it has a label, else what is not heart.
 * @param {readonly {value: number, name: string, role: string}[]} labels
 * @param {readonly string[]} between two names; one alone for the wall to the outside, which is muscle or none
 * @param {readonly {name: string, term: string | null}[]} [structures] with the vocabulary's words for them: recipes may call them LV
 * @returns {number | null} null where the recipe has none
 */
export function wallLabel(labels, between, structures = []) {
  const words = (/** @type {string} */ name) => structures.find((one) => one.name === name)?.term ?? name;
  const muscles = labels.filter(({ role }) => role === "myocardium").map(({ value, name }) => ({ value, name: words(name) }));
  const sides = between.map((name) => /(left|right) ventric/i.exec(words(name))?.[1]).filter((side) => side !== undefined);
  // a septum counts as the left one's, as segmentations have it
  for (const side of sides.sort()) {
    const own = muscles.find(({ name }) => new RegExp(`${side} ventric`, "i").test(name));
    if (own) return own.value;
  }
  const isOuter = between.length === 1;
  if (muscles.length === 1 && (isOuter || sides.length > 0)) return muscles[0].value;
  return isOuter ? null : (labels.find(({ role }) => role === "background")?.value ?? null);
}

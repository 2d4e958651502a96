/** A tour without a server: what its steps do was done when the page was made, and is played. */

import { TourPanel } from "./tour_panel.js";

/** @typedef {import("./tour_panel.js").Tour & {parts: number[], ends: number[]}} ToldTour */

/**
 * @param {HTMLElement} root
 * @param {readonly ToldTour[]} tours
 * @param {{shower: import("./scene.js").SceneShower, hide: (numbers: number[]) => void,
 *   play: (told: ToldTour, from: number, until: number) => void, leave: () => void,
 *   looked: () => void}} does `play` shows moments of what a tour does, `leave` none; `looked` is told when the eye is where it shall be
 */
export function showTours(root, tours, does) {
  const { shower } = does;
  const panel = new TourPanel(root, {
    show: (scene) => {
      does.hide(scene.hidden);
      shower.setPlane(scene.plane);
      if (scene.view !== null) shower.goTo(scene.view, does.looked);
    },
    enter: (number, step) => {
      const tour = tours[number];
      if (step === null) {
        does.leave();
        return;
      }
      const isTold = step < tour.ends.length;
      if (tour.steps[step].acts && !isTold) queueMicrotask(() => panel.hear({ tour: number, step, state: "shown_only" }));
      const at = Math.min(step, tour.ends.length - 1);
      const end = at < 0 ? 1 : tour.ends[at];
      // before the first step that does something the heart is as at the start
      if (end <= 1) {
        does.leave();
        return;
      }
      const before = at === 0 ? 1 : tour.ends[at - 1];
      const doesSomething = isTold && tour.steps[step].acts;
      does.play(tour, doesSomething ? before - 1 : end - 1, end - 1);
    },
  });
  panel.setTours(tours, []);
  return panel;
}

/** Where the focus goes after a click by mouse, pen or finger: keys such as the space bar are the page's there, not the button's. */

/** Buttons above and below the pictures, those in them, and tabs. */
const BUTTONS = ".bar button:not([popovertarget]), .scene-buttons button, [role=tab]";

/**
 * A click on one of these hands the focus on; whoever presses it by keys keeps it there.
 * @param {() => HTMLElement} next where one goes on
 */
export function handFocusOn(next) {
  document.addEventListener("click", (event) => {
    const button = /** @type {Element} */ (event.target).closest(BUTTONS);
    // keys and programs that speak click without a count
    if (event.detail === 0 || button === null) return;
    // what a button opened may have taken the focus, or hold it, as a dialog does
    const { activeElement } = document;
    if ((activeElement === button || activeElement === document.body) && !document.querySelector("dialog[open]")) next().focus({ preventScroll: true });
  });
}

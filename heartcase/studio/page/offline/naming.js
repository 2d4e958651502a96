/** A click that goes nowhere asks what lies there. */

const MOST_PX = 5;

/** @param {HTMLElement} surface @param {(x: number, y: number) => void} ask pixels from the upper left corner */
export function runNaming(surface, ask) {
  /** @type {{id: number, x: number, y: number} | null} */
  let began = null;
  surface.addEventListener("pointerdown", (event) => {
    // a second finger is no click
    began = began === null && event.button === 0 && !event.shiftKey ? { id: event.pointerId, x: event.clientX, y: event.clientY } : null;
  });
  surface.addEventListener("pointerup", (event) => {
    const start = began;
    began = null;
    if (start?.id !== event.pointerId || Math.hypot(event.clientX - start.x, event.clientY - start.y) > MOST_PX) return;
    const box = surface.getBoundingClientRect();
    ask(event.clientX - box.left, event.clientY - box.top);
  });
  surface.addEventListener("pointercancel", () => (began = null));
}

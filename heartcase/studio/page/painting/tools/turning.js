/** What mouse, pen, fingers and keys do on the solids: turn, move, zoom, and a click that takes the slices there. */

/** @typedef {import("../pictures/views.js").Views} Views */
/** @typedef {import("../studio.js").Studio} Studio */

const DEGREES_PER_PIXEL = 0.5;
const KEY_DEGREES = 15;
/** After the last movement it is drawn in full. */
const SETTLE_MS = 180;

/** @param {Views} views @param {Studio} studio @param {() => void} onClick the slices went where a click took them */
export function runTurning(views, studio, onClick) {
  const view = views.solid;
  const { surface, camera } = view;
  /** @type {Map<number, {x: number, y: number}>} */
  const down = new Map();
  let hasMoved = false;
  let isPanning = false;
  let settling = 0;

  const moved = () => {
    view.isTurning = true;
    views.redrawSolid();
    window.clearTimeout(settling);
    settling = window.setTimeout(() => {
      view.isTurning = false;
      if (view.fullMs > 0) views.redrawSolid();
    }, SETTLE_MS);
  };

  surface.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    surface.focus({ preventScroll: true });
    surface.setPointerCapture(event.pointerId);
    down.set(event.pointerId, { x: event.clientX, y: event.clientY });
    hasMoved = down.size > 1;
    isPanning = event.button !== 0 || event.shiftKey || studio.panning.value;
  });
  surface.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before) return;
    const now = { x: event.clientX, y: event.clientY };
    const [dx, dy] = [now.x - before.x, now.y - before.y];
    if (!hasMoved && Math.hypot(dx, dy) < 4) return;
    hasMoved = true;
    const other = [...down].find(([pointer]) => pointer !== event.pointerId)?.[1];
    if (other) {
      const box = surface.getBoundingClientRect();
      const apart = (/** @type {{x: number, y: number}} */ at) => Math.max(Math.hypot(at.x - other.x, at.y - other.y), 1);
      camera.pan(dx / 2, dy / 2);
      camera.zoom(apart(now) / apart(before), (now.x + other.x) / 2 - box.left, (now.y + other.y) / 2 - box.top);
    } else if (isPanning) camera.pan(dx, dy);
    else view.turn(-dx * DEGREES_PER_PIXEL, dy * DEGREES_PER_PIXEL);
    down.set(event.pointerId, now);
    moved();
  });
  const up = (/** @type {PointerEvent} */ event) => {
    const isClick = down.delete(event.pointerId) && event.type === "pointerup" && !hasMoved && event.button === 0;
    const lattice = studio.lattice.value;
    if (!isClick || lattice === null || views.volume === null) return;
    const box = surface.getBoundingClientRect();
    const through = views.surfaceShown && views.surfaceCut ? studio.crosshair.value : null;
    const mm = view.surfaceAt(event.clientX - box.left, event.clientY - box.top, lattice, views.volume, through);
    if (!mm) return;
    views.lookAt(mm);
    onClick();
  };
  surface.addEventListener("pointerup", up);
  surface.addEventListener("pointercancel", up);
  surface.addEventListener("contextmenu", (event) => event.preventDefault());
  surface.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = surface.getBoundingClientRect();
    const factor = Math.exp(-Math.sign(event.deltaY || event.deltaX) * 0.1);
    camera.zoom(factor, event.clientX - box.left, event.clientY - box.top);
    moved();
  }, { passive: false });
  surface.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    /** @type {Record<string, () => void>} */
    const keys = {
      ArrowLeft: () => view.turn(KEY_DEGREES, 0),
      ArrowRight: () => view.turn(-KEY_DEGREES, 0),
      ArrowUp: () => view.turn(0, -KEY_DEGREES),
      ArrowDown: () => view.turn(0, KEY_DEGREES),
      "+": () => camera.zoom(1.2, camera.width / 2, camera.height / 2),
      "-": () => camera.zoom(1 / 1.2, camera.width / 2, camera.height / 2),
      // nothing is painted where no slice is in hand
      Enter: () => undefined,
    };
    const act = keys[event.key];
    if (!act) return;
    event.preventDefault();
    act();
    moved();
  });
}

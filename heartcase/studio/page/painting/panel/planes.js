/** Which planes the slices show: the patient's, the scan's, the heart's own, or turned by hand. */

import { heartPlanes, lacking, PATIENT_PLANES, scanPlanes, VIEWS } from "../pictures/planes.js";
import { language, say } from "../../shared/words.js";
import { element } from "../../shared/elements.js";

/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../../shared/words.js").Word} Word */
/** @typedef {import("../pictures/views.js").Views} Views */
/** @typedef {import("../pictures/planes.js").Found} Found */

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/**
 * @param {Studio} studio
 * @param {Views} views
 * @param {(request: {do: string}) => Promise<Record<string, any>>} ask
 * @param {(error: unknown) => void} onFault
 */
export function runPlanes(studio, views, ask, onFault) {
  const said = find("planes-said");
  /** What the chosen planes lack. @type {ReturnType<typeof lacking>} */
  let lacks = [];
  let isNone = false;

  /** What was chosen is seen in the slices, unless there is more to read here. */
  const close = () => find("planes").hidePopover();

  /** @param {"heart" | "heart3"} name */
  const takeHeart = async (name) => {
    /** @type {Found} */
    let found;
    try {
      found = /** @type {any} */ (await ask({ do: "planes" }));
    } catch (error) {
      onFault(error);
      return;
    }
    const planes = heartPlanes(name, found);
    lacks = lacking(name, found);
    isNone = planes === null;
    if (planes) {
      studio.planes.value = planes;
      if (found.centre_mm) views.lookAt(found.centre_mm);
    }
    tell();
    if (planes && lacks.length === 0) close();
  };

  const tell = () => {
    const now = studio.planes.value.name;
    for (const button of /** @type {NodeListOf<HTMLButtonElement>} */ (document.querySelectorAll("[data-planes]"))) {
      button.setAttribute("aria-pressed", String(button.dataset.planes === now));
      if (button.dataset.planes === "scan") button.hidden = !studio.lattice.value?.isOblique;
    }
    const lines = lacks.map(({ plane, structures }) =>
      element("p", "", say("plane_lacks", { plane: say(plane), structures: structures.join(", ") })),
    );
    said.replaceChildren(...(isNone ? [element("p", "", say("planes_none"))] : []), ...lines);
    find("turn-about").textContent = say("turn_about", { view: titleOf(studio, studio.activeView.value) });
  };

  for (const button of /** @type {NodeListOf<HTMLButtonElement>} */ (document.querySelectorAll("[data-planes]"))) {
    button.addEventListener("click", () => {
      const name = button.dataset.planes;
      lacks = [];
      isNone = false;
      if (name === "heart" || name === "heart3") void takeHeart(name);
      else if (name === "scan" && studio.lattice.value) studio.planes.value = scanPlanes(studio.lattice.value);
      else studio.planes.value = PATIENT_PLANES;
      tell();
      if (name !== "heart" && name !== "heart3") close();
    });
  }
  for (const [id, way] of /** @type {const} */ ([["turn-left", -1], ["turn-right", 1]])) {
    find(id).addEventListener("click", () => views.turnStep(way));
  }
  for (const signal of [studio.planes, studio.lattice, studio.activeView, language]) {
    /** @type {import("../../shared/signal.js").Signal<any>} */ (signal).listen(tell);
  }
  for (const signal of [studio.planes, language]) {
    /** @type {import("../../shared/signal.js").Signal<any>} */ (signal).listen(() => tellTitles(studio, views));
  }
  tell();
}

/** What a view shows now, as words. @param {Studio} studio @param {import("../pictures/planes.js").ViewName} view */
function titleOf(studio, view) {
  const { titles, turned } = studio.planes.value;
  const title = say(titles[view]);
  return turned.includes(view) ? say("turned_view", { view: title }) : title;
}

/** Headings and names of the tiles. @param {Studio} studio @param {Views} views */
function tellTitles(studio, views) {
  for (const name of VIEWS) {
    const { tile, surface, slider } = views.byName[name];
    const view = titleOf(studio, name);
    const isOwn = view === say(name);
    /** @type {HTMLElement} */ (tile.querySelector("h2")).textContent = view;
    tile.setAttribute("aria-label", view);
    slider.title = isOwn ? say(`slice_${name}`) : say("slice_of_view", { view });
    slider.setAttribute("aria-label", slider.title);
    surface.setAttribute("aria-label", isOwn ? say(`surface_${name}`) : say("picture_of_view", { view }));
  }
}

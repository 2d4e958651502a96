/** Elements that pages are made of. */

import { placeOf, saidOf } from "./said.js";

/**
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {string} [className]
 * @param {string} [text]
 */
export function element(tag, className = "", text = "") {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text) made.textContent = text;
  return made;
}

/** One of the page's drawn icons. @param {string} name */
export function icon(name) {
  const space = "http://www.w3.org/2000/svg";
  const drawn = document.createElementNS(space, "svg");
  drawn.setAttribute("aria-hidden", "true");
  drawn.setAttribute("class", "icon");
  const use = document.createElementNS(space, "use");
  use.setAttribute("href", `#icon-${name}`);
  drawn.append(use);
  return drawn;
}

/** What is wrong, line by line. @param {readonly import("./connection.js").Problem[]} problems */
export function problemList(problems) {
  const list = element("ul", "problems");
  for (const problem of problems) {
    const row = element("li");
    for (const about of [problem.name, placeOf(problem.place)]) {
      if (about) row.append(element("span", "place", about), document.createTextNode(": "));
    }
    row.append(document.createTextNode(saidOf(problem)));
    list.append(row);
  }
  return list;
}

// What is told of a page that is saved, in the page's language.

import assert from "node:assert/strict";
import test from "node:test";

const elements = new Map();
const made = () => ({
  textContent: "", children: [], addEventListener() {}, removeAttribute() {},
  append(...parts) { this.children.push(...parts); },
  replaceChildren(...parts) { this.children = parts; },
});
globalThis.document = {
  getElementById: (id) => elements.get(id) ?? elements.set(id, made()).get(id),
  createElement: made,
  createTextNode: (text) => ({ textContent: text, children: [] }),
};
const { SavedPage } = await import("../../../heartcase/studio/page/figures/saved_page.js");
const { language } = await import("../../../heartcase/studio/page/shared/words.js");

/** @param {any} one @returns {string} */
const textOf = (one) => (typeof one === "string" ? one : one.textContent + one.children.map(textOf).join(""));
/** What is seen after a message. @param {object} message */
function seen(message) {
  new SavedPage(() => {}, () => {}, "/saved/x").hear(/** @type {any} */ ({ kind: "saved_page", ...message }));
  return textOf(elements.get("save-page-state"));
}

test("recordings keep their names, and what is wrong with the page is said in German", () => {
  language.value = "de";
  const short = { message: "x", code: "recording-not-whole", values: { seconds: "0.5" } };
  const facts = { state: "saved", name: "block.html", folder: "out", byte_count: 1e6 };
  assert.match(seen({ ...facts, problems: [{ place: "patch 2", ...short }, { place: "cut", ...short }] }), /patch 2: Sie .*cut: Sie /);
  assert.match(seen({ state: "failed", problems: [{ place: "page", message: "x", code: "page-ended" }] }), /Seite: Was die Seite speichert/);
});

// What the server says, in the page's language.

import assert from "node:assert/strict";
import test from "node:test";
import { problemList } from "../../../heartcase/studio/page/shared/elements.js";
import { nameOf, placeOf, saidOf } from "../../../heartcase/studio/page/shared/said.js";
import { language } from "../../../heartcase/studio/page/shared/words.js";

const made = () => ({ textContent: "", children: [], append(...parts) { this.children.push(...parts); } });
globalThis.document = { createElement: made, createTextNode: (text) => ({ textContent: text, children: [] }) };
/** @param {any} one @returns {string} */
const textOf = (one) => one.textContent + one.children.map(textOf).join("");

const grabbed = { message: "as it came", code: "grab-nothing", values: { radius: "2.5", far: "1,200.5" } };

test("English is what the server says", () => {
  language.value = "en";
  assert.equal(saidOf(grabbed), "as it came");
  assert.equal(placeOf("hand 1"), "hand 1");
});

test("German is by kind and values, with German numbers and names of instruments", () => {
  language.value = "de";
  assert.match(saidOf(grabbed), /^Im Umkreis von 2,5 mm .* liegt 1\.200,5 mm /);
  assert.equal(saidOf({ message: "x", code: "recording-done", values: { name: "hand 1.recording" } }), "Aufgenommen in hand 1.recording");
  assert.match(saidOf({ message: "x", code: "excise-held", values: { names: "hand 1, forceps 2" } }), /\(Hand 1, Pinzette 2\)/);
  assert.equal(placeOf("hand 1"), "Hand 1");
  assert.equal(placeOf("VSD and more"), "VSD and more");
});

test("a name that a user gave is not translated", () => {
  language.value = "de";
  assert.equal(nameOf("hand 1"), "Hand 1");
  assert.equal(nameOf("row 1 3"), "Naht 1 3");
  for (const name of ["cut", "tour", "my hand 1", "constructor"]) assert.equal(nameOf(name), name);
  assert.match(saidOf({ message: "x", code: "excise-held", values: { names: "cut, my hand 1, hand 2" } }), /\(cut, my hand 1, Hand 2\)/);
  // of a recording that is called like something else
  assert.equal(textOf(problemList([{ name: "patch 2", place: "hand 1", message: "so" }])), "patch 2: Hand 1: so");
  assert.equal(textOf(problemList([{ name: "tour", place: "", message: "so" }, { place: "", message: "so" }])), "tour: soso");
});

test("words that every object has are neither places nor kinds", () => {
  language.value = "de";
  for (const word of ["constructor", "valueOf", "toString"]) {
    assert.equal(placeOf(word), word);
    assert.equal(saidOf({ message: "odd", code: word }), "odd");
  }
});

test("words in a message that are of a kind themselves are German too", () => {
  language.value = "de";
  const trouble = { message: "x", code: "trouble-energy", values: { from: "0.5", to: "9" } };
  assert.match(saidOf({ message: "x", code: "broke-down", values: { from: "1.0", to: "1.1", trouble } }), /\(ihre Energie wuchs von selbst von 0,5 J auf 9 J\)/);
  assert.match(saidOf({ message: "x", code: "device-lost", values: { why: "odd" } }), /^odd\. Seine Hand/);
});

test("what has no kind, or one of a newer server, stays as it is", () => {
  language.value = "de";
  assert.equal(saidOf({ message: "odd" }), "odd");
  assert.equal(saidOf({ message: "odd", code: "newer", values: {} }), "odd");
});

// What the server says, in the page's language.

import assert from "node:assert/strict";
import test from "node:test";
import { placeOf, saidOf } from "../../../heartcase/studio/page/shared/said.js";
import { language } from "../../../heartcase/studio/page/shared/words.js";

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

test("what has no kind, or one of a newer server, stays as it is", () => {
  language.value = "de";
  assert.equal(saidOf({ message: "odd" }), "odd");
  assert.equal(saidOf({ message: "odd", code: "newer", values: {} }), "odd");
});

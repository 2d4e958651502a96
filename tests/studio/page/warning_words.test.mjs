// Sentences of warnings in the page's language.

import assert from "node:assert/strict";
import test from "node:test";
import { filled, warningWords } from "../../../heartcase/studio/page/building/warning_words.js";
import { language } from "../../../heartcase/studio/page/shared/words.js";

test("a template takes its values, its optional parts and its number", () => {
  const template = "{count#} <Teil|Teile>[ und {more#} mehr], [[pins]] \\[x\\]";
  assert.equal(filled(template, { count: "1" }), "1 Teil, [[pins]] [x]");
  assert.equal(filled(template, { count: "3", more: "1,234.5" }), "3 Teile und 1.234,5 mehr, [[pins]] [x]");
});

test("English is what the server says, German is from kind and values, and what has no words stays English", () => {
  const warning = { text: "The aorta ends in a closed sac.", code: "closed-sac", parts: { label: "aorta", about: "ends[1]" } };
  language.value = "en";
  assert.equal(warningWords(warning), warning.text);
  language.value = "de";
  assert.match(warningWords(warning), /^Ends\[1\]: aorta endet in einem geschlossenen Sack.*\.$/);
  assert.equal(warningWords({ text: "Odd.", code: "", parts: {} }), "Odd.");
  const places = { text: "", code: "wall-gap", parts: { label: "aorta", where: "over 60 mm² in 2 patches, the largest near (-5.1, -0.7, -2.4) mm" } };
  assert.match(warningWords(places), /Lücke auf 60 mm² an 2 Stellen, die größte bei \(-5\.1, -0\.7, -2\.4\) mm und/);
});

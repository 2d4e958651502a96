// Sentences of warnings in the page's language.

import assert from "node:assert/strict";
import test from "node:test";
import { filled, warningWords } from "../../../heartcase/studio/page/building/warning_words.js";
import { language } from "../../../heartcase/studio/page/shared/words.js";

test("a template takes its values, its optional parts and its number", () => {
  language.value = "de";
  const template = "{count#} <Teil|Teile>[ und {more#} mehr], [[pins]] \\[x\\]";
  assert.equal(filled(template, { count: "1" }), "1 Teil, [[pins]] [x]");
  assert.equal(filled(template, { count: "3", more: "1,234.5" }), "3 Teile und 1.234,5 mehr, [[pins]] [x]");
});

test("English is what the server says but for settings of a recipe's file, German is from kind and values", () => {
  const warning = { text: "The aorta ends in a closed sac.", code: "closed-sac", parts: { label: "aorta", about: "ends[1]" } };
  language.value = "en";
  assert.match(warningWords(warning), /^Vessel end 1: The aorta ends in a closed sac, .*\(Shape, Find vessel ends\)\.$/);
  const thin = { text: "", code: "smoothed-narrower", parts: { label: "aorta", place: "(1.5, 2, 3)", before: "4.5", after: "3.2" } };
  assert.equal(warningWords(thin), "Aorta: the smoothing of the outlines narrows it near L 1.5 P 2.0 H 3.0 mm from 4.5 mm to 3.2 mm; smooth less (Shape, Walls).");
  const shut = { text: "ends[2] (aorta): other structures close the vessel.", code: "end-shut", parts: { about: "ends[2] (aorta)" } };
  assert.equal(warningWords(shut), "Vessel end 2 (aorta): other structures close the vessel.");
  assert.equal(warningWords({ text: 'Edits[3] "VSD": odd.', code: "", parts: {} }), 'Edit 3 "VSD": odd.');
  language.value = "de";
  assert.match(warningWords(warning), /^Gefäßende 1: Aorta endet in einem geschlossenen Sack.*\.$/);
  assert.equal(warningWords({ text: "Odd.", code: "", parts: {} }), "Odd.");
  const places = { text: "", code: "wall-gap", parts: { label: "aorta", where: "over 60 mm² in 2 patches, the largest near (-5.1, -0.7, -2.4) mm" } };
  assert.match(warningWords(places), /Lücke auf 60 mm² an 2 Stellen, die größte bei R 5,1 A 0,7 F 2,4 mm und/);
});

test("a name stays as it is, what is said about it is German", () => {
  language.value = "de";
  const says = (code, parts) => warningWords({ text: "", code, parts });
  const opening = { one: "Pouch and rest", other: "graft 3.5 mm near (x)", area: "12.5", place: "(1.0, 2.0, 3.0)" };
  assert.match(says("opening-stated", { ...opening, by: "the landmark 'VSD and more'" }),
    /^Pouch and rest und graft 3\.5 mm near \(x\) sind .* auf 12,5 mm² bei L 1,0 P 2,0 H 3,0 mm, wie angegeben durch die Landmarke 'VSD and more'\.$/);
  assert.match(says("opening-too-large", { ...opening, by: "strokes 3 and 5, which run into each other" }), /angegeben durch die Striche 3 und 5, die ineinander laufen: /);
  assert.match(says("opening-stated", { ...opening, by: 'edits[2] "near (and) over"' }), /durch die Änderung 2 "near \(and\) over"\.$/);
  assert.match(says("wall-gap", { label: "A and B", where: "over 3.5 mm² near (1.0, 2.0, 3.0) mm" }), /^A and B: Die Wand hat eine Lücke auf 3,5 mm² bei L 1,0 P 2,0 H 3,0 mm und/);
});

test("the faces of a scan have German names", () => {
  language.value = "de";
  const faces = {
    "the head face of the scan": "Die Seite des Bildes zum Kopf",
    "the face towards left and feet of the region of interest": "Die Seite des Ausschnitts nach links und zu den Füßen",
    "the last slice (towards head and left) of the scan or its region of interest": "Die letzte Schicht des Bildes oder seines Ausschnitts (zum Kopf und nach links)",
  };
  for (const [face, german] of Object.entries(faces)) {
    const said = warningWords({ text: "", code: "heart-cut-off", parts: { face, listed: "veins of the left and right (3.5 cm²), left ventricle (40 mm²)" } });
    assert.ok(said.startsWith(`${german} schneidet das Herz ab, ohne Gefäßende: Venen von left and right (3,5 cm²), linker Ventrikel (40 mm²). Was`), said);
  }
});

test("what a warning lists is German about its names", () => {
  language.value = "de";
  const grown = (listed) => warningWords({ text: "", code: "grown-septum", parts: { listed } });
  assert.ok(grown("left atrium and aorta over 30 mm² near (1.0, 2.0, 3.0) mm (1.5 mm thick); a and b over 2.5 mm² near (0.0, 0.0, 1.0) mm (2 mm thick)")
    .includes(": linker Vorhof und Aorta auf 30 mm² bei L 1,0 P 2,0 H 3,0 mm (1,5 mm dick); a und b auf 2,5 mm² bei L 0,0 P 0,0 H 1,0 mm (2 mm dick). Ist"));
  // which "and" is between the names nobody knows
  assert.ok(grown("a and b and c over 2.5 mm² near (0.0, 0.0, 1.0) mm (2 mm thick)").includes(": a and b and c auf 2,5 mm² bei "));
  const stray = warningWords({ text: "", code: "stray-pieces", parts: { label: "aorta", pieces: "5", listed: "0.5 ml near (1, 2, 3) mm, 0.25 ml near (4, 5, 6) mm and 2 more" } });
  assert.ok(stray.includes(": 0,5 ml bei L 1,0 P 2,0 H 3,0 mm, 0,25 ml bei L 4,0 P 5,0 H 6,0 mm und 2 weitere: "), stray);
  const gaps = (places) => warningWords({ text: "", code: "small-gaps", parts: { cell: "0.9", count: "9", places } });
  assert.ok(gaps("the first at (1.0, 2.0, 3.0) mm and 6 more").includes("(0,9 mm): 9 Stellen, die ersten bei L 1,0 P 2,0 H 3,0 mm und 6 weitere. "));
  const loose = warningWords({ text: "", code: "floating-tissue", parts: { count: "1", cells: "1,234 cells", place: "(1.0, 2.0, 3.0)" } });
  assert.ok(loose.startsWith("1 Stück Gewebe (1.234 Zellen) hängt"), loose);
});

test("places, panels and what the user said are called as on the page", () => {
  const says = (code, parts) => warningWords({ text: "", code, parts });
  const opening = { one: "right ventricle", other: "left ventricle", area: "12.5", place: "(-5.1, -1.6, -2.4)" };
  language.value = "en";
  assert.match(says("opening-stated", { ...opening, by: "walls.contact[1]" }), /near R 5\.1 A 1\.6 F 2\.4 mm, as stated by you, of this place\.$/);
  assert.match(says("opening-too-large", { ...opening, by: 'edits[2] "VSD"', asked: "9" }), /stated by edit 2 "VSD", where 9 mm² are asked for: /);
  const loose = "1 part of the tissue is loose, at (1.0, 2.0, 3.0), (4.0, 5.0, 6.0) mm: make the cells smaller.";
  assert.equal(warningWords({ text: loose, code: "loose-tissue", parts: {} }),
    "1 part of the tissue is loose, at L 1.0 P 2.0 H 3.0, L 4.0 P 5.0 H 6.0 mm: make the cells smaller (Shape, Model and surface).");
  assert.match(warningWords({ text: "walls.contact[2]: odd.", code: "", parts: {} }), /^What you said of place 2: odd\.$/);
  language.value = "de";
  assert.match(says("opening-stated", { ...opening, by: "walls.contact[1]" }), /bei R 5,1 A 1,6 F 2,4 mm, wie angegeben durch Sie, zu dieser Stelle\.$/);
  assert.match(says("loose-tissue", { count: "2", places: "(1.0, 2.0, 3.0) mm" }), /Machen Sie die Zellen kleiner \(Form, Modell und Oberfläche\)\.$/);
});

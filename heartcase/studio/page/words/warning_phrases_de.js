/** Phrases within values of warnings in German, by the value's name: what they say about names stays as it is. */

/** @param {string} text */
const number = (text) => text.replace(/[.,]/g, (mark) => (mark === "." ? "," : "."));

/** @type {Record<string, string>} */
const WAYS = { right: "nach rechts", left: "nach links", front: "nach vorn", back: "nach hinten", feet: "zu den Füßen", head: "zum Kopf" };
/** @type {Record<string, string>} */
const OF = { "scan": "des Bildes", "region of interest": "des Ausschnitts", "scan or its region of interest": "des Bildes oder seines Ausschnitts" };
/** @param {string} words such as `head and left` */
const ways = (words) => words.split(" and ").map((one) => WAYS[one] ?? one).join(" und ");

/** Two names; where a name has an "and" of its own nobody knows which one is between them. @param {string} names */
function pair(names) {
  const parts = names.split(" and ");
  return parts.length === 2 ? parts.join(" und ") : names;
}

/** Patterns and what is said for them, one after the other. @type {Record<string, [RegExp, (...found: string[]) => string][]>} */
export const phrases = {
  by: [
    [/^walls\.contact\[\d+\]$/, () => "Sie, zu dieser Stelle"],
    [/^edits\[(\d+)\]/, (_, number) => `die Änderung ${number}`],
    [/^the landmark (?='.*'$)/, () => "die Landmarke "],
    [/^strokes (\d+) and (\d+), which run into each other$/, (_, one, other) => `die Striche ${one} und ${other}, die ineinander laufen`],
  ],
  face: [
    [/^the (\w+) face of the ([\w ]+)$/, (_, way, of) => `die Seite ${OF[of] ?? of} ${ways(way)}`],
    [/^the face towards ([\w ]+) of the ([\w ]+)$/, (_, way, of) => `die Seite ${OF[of] ?? of} ${ways(way)}`],
    [/^the (first|last) slice \(towards ([\w ]+)\) of the ([\w ]+)$/, (_, which, way, of) => `die ${which === "first" ? "erste" : "letzte"} Schicht ${OF[of] ?? of} (${ways(way)})`],
  ],
  listed: [
    // grown walls
    [/(^|; )((?:(?!; ).)+) over ([\d.,]+) mm² near (\([^)]*\)) mm \(([\d.]+) mm thick\)(?=; |$)/g,
      (_, before, names, area, place, wall) => `${before}${pair(names)} auf ${number(area)} mm² bei ${place} mm (${number(wall)} mm dick)`],
    // stray pieces
    [/(^|, )([\d.e+-]+) ml near (?=\([^)]*\) mm)/g, (_, before, volume) => `${before}${number(volume)} ml bei `],
    [/(?<=\) mm) and (\d+) more$/, (_, more) => ` und ${more} weitere`],
    // what a face cuts
    [/(^|²\), )veins of the (.+?)(?= \([\d.]+ [cm]m²\))/g, (_, before, name) => `${before}Venen von ${name}`],
    [/\(([\d.]+) cm²\)(?=, |$)/g, (_, area) => `(${number(area)} cm²)`],
  ],
  where: [
    [/^over ([\d.,]+) mm²/, (_, area) => `auf ${number(area)} mm²`],
    [/ in (\d+) patches, the largest near \(/, (_, count) => ` an ${count} Stellen, die größte bei (`],
    [/ near \(/, () => " bei ("],
  ],
  places: [
    [/^the first at (?=\()/, () => "die ersten bei "],
    [/^at (?=\()/, () => "bei "],
    [/ and (\d+) more$/, (_, more) => ` und ${more} weitere`],
  ],
  cells: [[/^([\d,]+) cells?$/, (_, count) => `${number(count)} ${count === "1" ? "Zelle" : "Zellen"}`]],
};

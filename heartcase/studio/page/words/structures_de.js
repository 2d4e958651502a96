/** What structures of the vocabulary, and the coronary arteries, are called in German. */

/** By their English names in lower case; other names stay as they are. @type {Record<string, string>} */
export const structures = {
  "background": "Hintergrund",
  "morphologically left ventricle": "linker Ventrikel",
  "morphologically right ventricle": "rechter Ventrikel",
  "morphologically left atrium": "linker Vorhof",
  "morphologically right atrium": "rechter Vorhof",
  "morphologically left ventricular myocardium": "Myokard des linken Ventrikels",
  "morphologically right ventricular myocardium": "Myokard des rechten Ventrikels",
  "left ventricle": "linker Ventrikel",
  "right ventricle": "rechter Ventrikel",
  "left atrium": "linker Vorhof",
  "right atrium": "rechter Vorhof",
  "left ventricular myocardium": "Myokard des linken Ventrikels",
  "right ventricular myocardium": "Myokard des rechten Ventrikels",
  "myocardium": "Myokard",
  "aorta": "Aorta",
  "pulmonary artery": "Pulmonalarterie",
  "superior vena cava": "obere Hohlvene",
  "inferior vena cava": "untere Hohlvene",
  "pulmonary vein": "Lungenvene",
  "pulmonary veins": "Lungenvenen",
  "coronary sinus": "Sinus coronarius",
  "left atrial appendage": "linkes Herzohr",
  "right atrial appendage": "rechtes Herzohr",
  "right coronary artery": "rechte Koronararterie",
  "left anterior descending artery": "Ramus interventricularis anterior",
  "left circumflex artery": "Ramus circumflexus",
};
/** A wall that was grown around a structure, and one between two that nobody saw. */
export const wallOf = (/** @type {string} */ name) => `Wand: ${name}`;
export const septumOf = (/** @type {string} */ one, /** @type {string} */ other) => `Septum: ${one} – ${other} (gewachsen)`;

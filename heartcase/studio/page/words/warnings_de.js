/** Sentences of warnings in German, by their kind; heartcase/pipeline/warning_words.py has the English ones. */

/** @type {Record<string, string>} */
export const warnings = {
  "grown-septum": "Wo sich zwei Umrisse berühren, die im Herzen nicht verbunden sind, wurden Wände ergänzt, die niemand gesehen hat: {listed}. Ist dort eine echte Öffnung, geben Sie sie an",
  "grown-septum-confirmed": "Die ergänzte Wand zwischen {one} und {other}, {area#} mm² bei {place} mm, ist Wand, wie das Rezept sagt",
  "opening-unexpected": "{one} und {other} sind zueinander offen, auf {area#} mm²[ an {patches#} Stellen, die größte] bei {place} mm: Malen Sie die Wand dazwischen (ein Strich Hintergrund oder Muskel) oder den dritten Hohlraum, dessen Blut sie bekommen haben; oder lassen Sie eine Wand ergänzen; oder geben Sie die Öffnung an, wenn der Patient sie hat",
};

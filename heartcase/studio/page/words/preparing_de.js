/** Words of the recipe's page that came with places where outlines touch, and with names, in German. */

/** @type {Record<keyof typeof import("./preparing_en.js").words, string>} */
export const words = {
  place_right: "Es stimmt (R)",
  help_right: "Die gezeigte Stelle stimmt: weiter zur nächsten",
  end_lumen: "Lumen {lumen} mm, Scheibe {disc}",
  end_narrow: "Lumen über {lumen} mm: Scheibe ({disc}) zu eng",
  end_beside: "nicht im Gefäß, Scheibe {disc} mm",
  end_disc: "Scheibe {disc} mm",
  contact_head: "Hier berühren sich zwei Umrisse, die im Herzen nicht verbunden sind. Es wurde eine Wand ergänzt, die niemand gesehen hat. Sagen Sie von jeder Stelle, was sie ist:",
  contact_grown: "{mm2} mm² (als Kreis {mm} mm); eine Wand von {wall} mm wurde ergänzt",
  contact_picture: "Die Stelle im Bild: axial, koronal",
  contact_fly: "Dorthin",
  contact_real: "Es ist ein echter Defekt: offen lassen",
  contact_is_wall: "Es ist Wand",
  contact_grow: "Es ist Wand: ergänzen",
  contact_back: "Zurücknehmen",
  contact_said_open: "Ein echter Defekt, sagt das Rezept.",
  contact_said_wall: "Wand, sagt das Rezept.",
  contact_stated: "Offen: Das Rezept gibt hier einen Defekt an.",
  contact_apart: "Eine Wand ist verlangt.",
  contact_build: "Neu bauen, damit es gilt.",
  contact_noted: "Der nächste Bau vermerkt es.",
  contact_open: "Offen gelassen: {pair}",
  contact_wall: "Wand: {pair}",
  septum_between: "Getrennt: {pair}",
  field_is_open: "Ist offen",
};

/** Words of the recipe's page that came with places where outlines touch, and with names, in English. */

export const words = {
  contact_head: "Two outlines touch here, and a heart does not join these. A wall was grown that nobody saw. Say of each place what it is:",
  contact_grown: "{mm2} mm² (a circle of {mm} mm); a wall of {wall} mm was grown",
  contact_picture: "The place in the scan: axial, coronal",
  contact_fly: "Go there",
  contact_real: "It is a real defect: keep it open",
  contact_is_wall: "It is wall",
  contact_grow: "It is wall: grow one",
  contact_back: "Take back",
  contact_said_open: "A real defect, says the recipe.",
  contact_said_wall: "Wall, says the recipe.",
  contact_stated: "Open: the recipe states a defect here.",
  contact_apart: "A wall is asked for.",
  contact_build: "Build again to have it.",
  contact_noted: "The next build notes it.",
  contact_open: "Kept open: {pair}",
  contact_wall: "Wall: {pair}",
  septum_between: "Kept apart: {pair}",
  field_is_open: "Is open",
};

/** Words of what is seen besides the heart, in German: cut plane, slices of the scan, second view, surroundings. */

export const words = {
  section_move: "Schnittebene verschieben",
  section_turn: "Schnittebene drehen",
  section_at: "{mm} mm von der Mitte",
  section_turned: "{around}° herum, {up}° hinauf",
  scene_view: "Ansicht",
  scene_cut_open: "Aufschneiden",
  scene_cut_open_tip: "Herz mit einer Ebene aufschneiden (K)",
  scene_plane: "Schnittebene",
  scene_plane_along: "Entlang",
  scene_plane_depth: "Lage der Schnittebene",
  scene_plane_flip: "Andere Seite",
  scene_plane_face: "Ansehen",
  scene_plane_free: "von Hand gedreht",
  scene_plane_look: "Bildschirm",
  scene_plane_short_axis: "Kurzachse",
  scene_plane_four_chamber: "Vierkammer",
  scene_plane_two_chamber: "Zweikammer",
  scene_plane_three_chamber: "Dreikammer",
  scene_help_plane: "Herz aufschneiden; 1 mm näher, ferner",
};

/** Words of what is seen besides the heart, in English: cut plane, slices of the scan, second view, surroundings. */

export const words = {
  section_move: "Move the cut plane",
  section_turn: "Turn the cut plane",
  section_at: "{mm} mm from the middle",
  section_turned: "{around}° around, {up}° up",
  scene_view: "View",
  scene_cut_open: "Cut open",
  scene_cut_open_tip: "Cut the heart open by a plane (K)",
  scene_plane: "Cut plane",
  scene_plane_along: "Along",
  scene_plane_depth: "Place of the cut plane",
  scene_plane_flip: "Other side",
  scene_plane_face: "Look at it",
  scene_plane_free: "turned by hand",
  scene_plane_look: "the screen",
  scene_plane_short_axis: "short axis",
  scene_plane_four_chamber: "four-chamber",
  scene_plane_two_chamber: "two-chamber",
  scene_plane_three_chamber: "three-chamber",
  scene_help_plane: "cut the heart open; nearer, farther by 1 mm",
};

// Prints, for each frame: its name, what becomes of four points, and what the
// chirality check says of them as they are, mirrored, doubled and flattened;
// then a list of triangles turned round.

#include <cstdio>

#include "coordinates.hpp"

using namespace heartcase;

static const char *judge(const std::array<Point, 4> &points,
                         const Frame &frame) {
  static std::string said;
  try {
    check_chirality(4.0, points, frame);
    said = "ok";
  } catch (const Error &error) {
    said = error.what();
  }
  return said.c_str();
}

int main() {
  const std::array<Point, 4> marks = {Point{1, 2, 3}, Point{3, 2, 3},
                                      Point{1, 5, 3}, Point{1, 2, 7}};
  for (const Frame &frame : {lps, gltf, unity, unreal}) {
    std::array<Point, 4> here{}, mirrored{}, doubled{}, flat{};
    for (std::size_t n = 0; n < 4; ++n) {
      here[n] = from_lps(frame, marks[n]);
      mirrored[n] = {-here[n][0], here[n][1], here[n][2]};
      doubled[n] = 2.0 * here[n];
      flat[n] = {here[n][0], here[n][1], 0.0};
    }
    std::printf("%s %d", frame.name, frame.reverse_triangles ? 1 : 0);
    for (const Point &p : here)
      std::printf(" %.17g %.17g %.17g", p[0], p[1], p[2]);
    std::printf("\n%s\n", judge(here, frame));
    std::printf("%s\n", judge(mirrored, frame));
    std::printf("%s\n", judge(doubled, frame));
    std::printf("%s\n", judge(flat, frame));
  }
  for (const std::int32_t vertex : reversed_winding({0, 1, 2, 7, 8, 9}))
    std::printf("%d ", vertex);
  std::printf("\n");
}

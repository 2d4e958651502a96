// From patient LPS in mm (x to the patient's left, y to the back, z to the head; right-handed) to other spaces, and the
// check that nothing was mirrored on the way.

#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "json.hpp"

namespace heartcase {

struct Point {
    std::array<double, 3> xyz{};

    double& operator[](std::size_t axis) { return xyz[axis]; }
    double operator[](std::size_t axis) const { return xyz[axis]; }
};

inline Point operator+(const Point& a, const Point& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Point operator-(const Point& a, const Point& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
inline Point operator*(double s, const Point& a) { return {s * a[0], s * a[1], s * a[2]}; }
inline double dot(const Point& a, const Point& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline Point cross(const Point& a, const Point& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline Point unit(const Point& a) {
    const double length = std::sqrt(dot(a, a));
    return length > 0.0 ? (1.0 / length) * a : Point{};  // a vector of no length has no direction
}

// Axes of another program; point there = from_lps_mm * (x, y, z).
struct Frame {
    const char* name;
    std::array<Point, 3> from_lps_mm;  // rows
    double millimetres_per_unit;
    bool left_handed;
    bool reverse_triangles;  // the program takes triangles that are clockwise on the screen for front faces
};

// The same in the `coordinates` block of case.json from format 1.1 on.
inline const Frame lps = {"lps", {{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}}, 1.0, false, false};
inline const Frame gltf = {"gltf", {{{0.001, 0.0, 0.0}, {0.0, 0.0, 0.001}, {0.0, -0.001, 0.0}}}, 1000.0, false, false};
inline const Frame unity = {"unity", {{{0.001, 0.0, 0.0}, {0.0, 0.0, 0.001}, {0.0, 0.001, 0.0}}}, 1000.0, true, true};
inline const Frame unreal = {"unreal", {{{0.0, 0.1, 0.0}, {0.1, 0.0, 0.0}, {0.0, 0.0, 0.1}}}, 10.0, true, false};

inline Point from_lps(const Frame& frame, const Point& p) {
    return {dot(frame.from_lps_mm[0], p), dot(frame.from_lps_mm[1], p), dot(frame.from_lps_mm[2], p)};
}

// The w of a tangent in `frame`: a shader works out B = cross(N, T) * w, and in left-handed axes the cross product has the
// other sign, so that without this a normal map would be lit from the wrong side.
inline double tangent_w(const Frame& frame, double w) { return frame.left_handed ? -w : w; }

// Triangles (row by row, three vertex numbers each) that face the other way.
inline std::vector<std::int32_t> reversed_winding(std::vector<std::int32_t> triangles) {
    for (std::size_t t = 0; t + 2 < triangles.size(); t += 3) std::swap(triangles[t + 1], triangles[t + 2]);
    return triangles;
}

// Signed volume (b - a) . ((c - a) x (d - a)) / 6 of a tetrahedron, in the cube of the points' unit.
inline double signed_volume(const std::array<Point, 4>& p) {
    return dot(p[1] - p[0], cross(p[2] - p[0], p[3] - p[0])) / 6.0;
}

// Throws Error unless four points, as your program holds them in `frame`, span the volume that the case states (mm3, in
// LPS). In left-handed axes the volume has the other sign, and only there.
inline void check_chirality(double volume_lps_mm3, const std::array<Point, 4>& points, const Frame& frame) {
    const double unit_mm = frame.millimetres_per_unit;
    const double found = signed_volume(points) * unit_mm * unit_mm * unit_mm * (frame.left_handed ? -1.0 : 1.0);
    if (!(std::abs(volume_lps_mm3) > 0.0)) throw Error("four landmarks in one plane cannot tell left from right");
    if (found * volume_lps_mm3 < 0.0)
        throw Error("the case is mirrored: four landmarks span the volume with the wrong sign");
    if (!(std::abs(found - volume_lps_mm3) <= 1e-3 * std::abs(volume_lps_mm3)))
        throw Error("the case is scaled or bent: four landmarks span the wrong volume");
}

}  // namespace heartcase

// How a case moves: springs and masses from its cells, steps in time, and the surface over moved nodes
// (docs/bundle.md). Inside in metres, kilograms, seconds and double precision; nodes and vertices are handed out in
// patient LPS mm.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "heartcase_reader.hpp"

namespace heartcase {

struct Spring {
    std::size_t a = 0, b = 0;  // node numbers, a < b
    double stiffness = 0.0;    // N/m
    double length = 0.0;       // m, at rest
};

struct Lattice {
    std::vector<Point> rest;   // m, patient LPS
    std::vector<double> mass;  // kg
    std::vector<std::uint8_t> fixed;
    std::vector<Spring> springs;  // by a, then b
};

// Node numbers of the corners of every cell, corner = di + 2 dj + 4 dk.
inline std::vector<std::array<std::size_t, 8>> corners_of_cells(const Case& bundle) {
    const auto& size = bundle.manifest.grid.size;
    const std::vector<std::int64_t> nodes = keys_of(bundle, "nodes", {size[0] + 1, size[1] + 1, size[2] + 1});
    const std::vector<std::int32_t> cells = bundle.values<std::int32_t>("grid", "cells");
    std::vector<std::array<std::size_t, 8>> corners(cells.size() / 3);
    for (std::size_t c = 0; c < corners.size(); ++c)
        for (std::size_t corner = 0; corner < 8; ++corner) {
            const std::int64_t i = cells[3 * c] + static_cast<int>(corner & 1),
                               j = cells[3 * c + 1] + static_cast<int>(corner >> 1 & 1);
            const std::int64_t key =
                ((cells[3 * c + 2] + static_cast<int>(corner >> 2)) * (size[1] + 1) + j) * (size[0] + 1) + i;
            corners[c][corner] =
                static_cast<std::size_t>(std::lower_bound(nodes.begin(), nodes.end(), key) - nodes.begin());
        }
    return corners;
}

// Every cell gives c k/4 to each of its 12 edges, c k/2 to each of its 12 face diagonals, k = 0.4 E h, and an eighth of
// its mass c rho h^3 to each corner.
inline Lattice build_lattice(const Case& bundle) {
    const double h = bundle.manifest.cell_mm * 1e-3;
    const std::vector<std::array<std::size_t, 8>> corners = corners_of_cells(bundle);
    const std::vector<float> coverage = bundle.values<float>("grid", "cell_coverage");
    const std::vector<float> stiffness = bundle.values<float>("grid", "cell_stiffness");
    const std::vector<float> density = bundle.values<float>("grid", "cell_density");
    const std::vector<std::int32_t> nodes = bundle.values<std::int32_t>("grid", "nodes");
    Lattice lattice;
    lattice.fixed = bundle.values<std::uint8_t>("grid", "fixed");
    lattice.mass.assign(nodes.size() / 3, 0.0);
    for (std::size_t n = 0; n + 2 < nodes.size(); n += 3)
        lattice.rest.push_back(1e-3 *
                               bundle.manifest.grid.point(nodes[n] - 0.5, nodes[n + 1] - 0.5, nodes[n + 2] - 0.5));
    std::vector<Spring> shares;
    for (std::size_t c = 0; c < corners.size(); ++c) {
        const double k = 0.4 * double{stiffness[c]} * 1e3 * h;
        for (const std::size_t node : corners[c])
            lattice.mass[node] += double{coverage[c]} * double{density[c]} * h * h * h / 8.0;
        for (std::size_t p = 0; p < 8; ++p)
            for (std::size_t q = p + 1; q < 8; ++q) {
                const std::size_t axes = ((p ^ q) & 1) + ((p ^ q) >> 1 & 1) + ((p ^ q) >> 2);
                if (axes == 3) continue;
                const auto [low, high] = std::minmax(corners[c][p], corners[c][q]);
                shares.push_back(
                    {low, high, double{coverage[c]} * k / (axes == 1 ? 4.0 : 2.0), axes == 1 ? h : std::sqrt(2.0) * h});
            }
    }
    std::stable_sort(shares.begin(), shares.end(),
                     [](const Spring& x, const Spring& y) { return std::pair(x.a, x.b) < std::pair(y.a, y.b); });
    for (const Spring& share : shares) {
        if (!lattice.springs.empty() && lattice.springs.back().a == share.a && lattice.springs.back().b == share.b) {
            lattice.springs.back().stiffness += share.stiffness;
        } else {
            lattice.springs.push_back(share);
        }
    }
    return lattice;
}

struct State {
    std::vector<Point> displacement;  // m
    std::vector<Point> velocity;      // m/s, half a step behind the displacement
};

inline State at_rest(const Lattice& lattice) {
    return {std::vector<Point>(lattice.rest.size()), std::vector<Point>(lattice.rest.size())};
}

// One step of `step_s` seconds; damping in 1/s, gravity in m/s2 along LPS.
inline void step(const Lattice& lattice, State& state, double step_s, double damping_per_s, const Point& gravity) {
    std::vector<Point> force(lattice.rest.size());
    for (const Spring& spring : lattice.springs) {
        const Point d = (lattice.rest[spring.b] - lattice.rest[spring.a]) +
                        (state.displacement[spring.b] - state.displacement[spring.a]);
        const double distance = std::sqrt(dot(d, d));
        if (!(distance > 0.0)) continue;  // no direction to pull in
        const Point pull = (spring.stiffness * (distance - spring.length) / distance) * d;
        force[spring.a] = force[spring.a] + pull;
        force[spring.b] = force[spring.b] - pull;
    }
    const double q = damping_per_s * step_s / 2.0;
    for (std::size_t n = 0; n < force.size(); ++n) {
        if (lattice.fixed[n] != 0) continue;
        const Point acceleration = (1.0 / lattice.mass[n]) * force[n] + gravity;
        state.velocity[n] = (1.0 / (1.0 + q)) * ((1.0 - q) * state.velocity[n] + step_s * acceleration);
        state.displacement[n] = state.displacement[n] + step_s * state.velocity[n];
    }
}

// Present positions of the nodes, patient LPS mm.
inline std::vector<Point> node_positions_mm(const Lattice& lattice, const State& state) {
    std::vector<Point> positions(lattice.rest.size());
    for (std::size_t n = 0; n < positions.size(); ++n) positions[n] = 1e3 * (lattice.rest[n] + state.displacement[n]);
    return positions;
}

struct Basis {
    Point t, n, b;
};

struct Surface {
    std::vector<Point> vertices_mm;
    std::vector<Point> normals;
};

// The visible surface, carried by the nodes (thesis 9.3.3). Needs the mapping file.
class SurfaceCarrier {
public:
    SurfaceCarrier(const Case& bundle, const Lattice& lattice)
        : springs_(lattice.springs),
          nodes_(bundle.values<std::int32_t>("mapping", "triangle_nodes")),
          weights_(bundle.values<float>("mapping", "weights")),
          curvature_(bundle.values<std::uint8_t>("mapping", "curvature")) {
        const std::vector<float> offset = bundle.values<float>("mapping", "offset");
        const std::vector<float> normal = bundle.values<float>("mapping", "normal");
        for (std::size_t v = 0; v < curvature_.size(); ++v) {
            offset_.push_back({offset[3 * v], offset[3 * v + 1], offset[3 * v + 2]});
            normal_.push_back({normal[3 * v], normal[3 * v + 1], normal[3 * v + 2]});
        }
        // The interpolated basis has components of its own: those that give the same vertex and normal at rest.
        const std::vector<Point> rest = node_positions_mm(lattice, at_rest(lattice));
        const std::vector<Point> node_normals = normals_of_nodes(rest);
        for (std::size_t v = 0; v < curvature_.size(); ++v) {
            if (curvature_[v] == 0) continue;
            const Basis plain = triangle_basis(v, rest);
            const Basis bent = interpolated_basis(v, plain, node_normals);
            if (!is_basis(v, plain, node_normals)) {
                curvature_[v] = 0;  // the nodes have tissue on both sides and no normal of their own
                continue;
            }
            for (Point* components : {&offset_[v], &normal_[v]}) {
                const Point world = along(plain, *components);
                *components = {dot(world, bent.t), dot(world, bent.n), dot(world, bent.b)};
            }
        }
    }

    // Vertices (mm) and normals (of length one but for rounding) over nodes at `positions` (mm).
    Surface over(const std::vector<Point>& positions) const {
        Surface surface;
        const std::vector<Point> node_normals = normals_of_nodes(positions);
        for (std::size_t v = 0; v < curvature_.size(); ++v) {
            Basis basis = triangle_basis(v, positions);
            if (curvature_[v] != 0) basis = interpolated_basis(v, basis, node_normals);
            Point foot{};
            for (std::size_t n = 0; n < 3; ++n) foot = foot + double{weights_[3 * v + n]} * positions[node(v, n)];
            surface.vertices_mm.push_back(foot + along(basis, offset_[v]));
            surface.normals.push_back(along(basis, normal_[v]));
        }
        return surface;
    }

private:
    std::size_t node(std::size_t v, std::size_t n) const { return static_cast<std::size_t>(nodes_[3 * v + n]); }
    static Point along(const Basis& basis, const Point& c) { return c[0] * basis.t + c[1] * basis.n + c[2] * basis.b; }

    Basis triangle_basis(std::size_t v, const std::vector<Point>& p) const {
        const Point& p1 = p[node(v, 0)];
        const Point t = unit(p[node(v, 1)] - p1);
        const Point n = unit(cross(p[node(v, 1)] - p1, p[node(v, 2)] - p1));
        return {t, n, cross(n, t)};
    }
    Point sum_of_normals(std::size_t v, const std::vector<Point>& node_normals) const {
        Point sum{};
        for (std::size_t n = 0; n < 3; ++n) sum = sum + double{weights_[3 * v + n]} * node_normals[node(v, n)];
        return sum;
    }
    bool is_basis(std::size_t v, const Basis& triangle, const std::vector<Point>& node_normals) const {
        const Point sum = sum_of_normals(v, node_normals), across = cross(unit(sum), triangle.t);
        return dot(sum, sum) > shortest * shortest && dot(across, across) > shortest * shortest;
    }
    Basis interpolated_basis(std::size_t v, const Basis& triangle, const std::vector<Point>& node_normals) const {
        const Point n = unit(sum_of_normals(v, node_normals));
        const Point b = unit(cross(n, triangle.t));
        return {cross(b, n), n, b};
    }
    std::vector<Point> normals_of_nodes(const std::vector<Point>& p) const {
        std::vector<Point> sums(p.size());
        if (std::find(curvature_.begin(), curvature_.end(), 1) == curvature_.end()) return sums;
        for (const Spring& spring : springs_) {
            const Point away = unit(p[spring.a] - p[spring.b]);
            sums[spring.a] = sums[spring.a] + away;
            sums[spring.b] = sums[spring.b] - away;
        }
        for (Point& sum : sums) sum = dot(sum, sum) < shortest * shortest ? Point{} : unit(sum);
        return sums;
    }

    static constexpr double shortest = 0.1;  // of a sum of unit vectors that still has a direction

    std::vector<Spring> springs_;
    std::vector<std::int32_t> nodes_;
    std::vector<float> weights_;
    std::vector<std::uint8_t> curvature_;
    std::vector<Point> offset_, normal_;
};

// Signed volume inside closed triangles that are counter-clockwise from outside.
inline double enclosed_volume_mm3(const std::vector<std::int32_t>& triangles, const std::vector<Point>& vertices_mm) {
    double six_volumes = 0.0;
    const auto corner = [&](std::size_t n) {
        return vertices_mm[static_cast<std::size_t>(triangles[n])] - vertices_mm[0];
    };
    for (std::size_t t = 0; t + 2 < triangles.size(); t += 3)
        six_volumes += dot(corner(t), cross(corner(t + 1), corner(t + 2)));
    return six_volumes / 6.0;
}

// Throws Error where the mapping at rest does not give back the surface, or the surface is inside out: a mirrored case.
inline void check_surface_at_rest(const Case& bundle, const Lattice& lattice, const SurfaceCarrier& carrier) {
    const std::vector<float> vertices = bundle.values<float>("surface", "vertices");
    const std::vector<std::int32_t> triangles = bundle.values<std::int32_t>("surface", "triangles");
    const std::vector<Point> rest = carrier.over(node_positions_mm(lattice, at_rest(lattice))).vertices_mm;
    for (std::size_t v = 0; v < rest.size(); ++v) {
        const Point gap = rest[v] - Point{vertices[3 * v], vertices[3 * v + 1], vertices[3 * v + 2]};
        if (!(dot(gap, gap) <= 3e-4))
            throw Error("the mapping does not give back the surface at rest: vertex " + std::to_string(v + 1));
    }
    if (!triangles.empty() && !(enclosed_volume_mm3(triangles, rest) > 0.0))
        throw Error("the surface is inside out: the case is mirrored or its triangles are turned");
}

}  // namespace heartcase

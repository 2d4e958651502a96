// Steps a case, and compares it with a golden file.
//
//   step CASE EXPECTED.json [--no-hashes]    run what the golden file says; exit code 1 and one line where it differs
//   step CASE COUNT [--nodes] [--no-hashes]  COUNT default steps under gravity; the time, and with --nodes the nodes
//
//   g++ -std=c++17 -O2 step.cpp -o step

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <string>
#include <vector>

#include "coordinates.hpp"
#include "heartcase_reader.hpp"
#include "lattice.hpp"

namespace {

using heartcase::Case;
using heartcase::Error;
using heartcase::Fields;
using heartcase::Json;
using heartcase::Lattice;
using heartcase::Point;
using heartcase::State;

double seconds_since(std::chrono::steady_clock::time_point start) {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

double number(const Fields& fields, const char* key) { return fields.get(key, Json::Kind::number).number; }

std::vector<Point> points(const Fields& fields, const char* key) {
    std::vector<Point> result;
    for (const Json& json : fields.list(key)) result.push_back(fields.point(json, key));
    return result;
}

// Prints the greatest distance, and throws where it is above the tolerance.
void compare(const std::string& what, const std::vector<Point>& found, const std::vector<Point>& expected,
             double tolerance_mm) {
    if (found.size() != expected.size()) throw Error(what + ": the golden file has another number of points");
    double worst = 0.0;
    for (std::size_t n = 0; n < found.size(); ++n) {
        const Point d = found[n] - expected[n];
        const double distance = std::sqrt(dot(d, d));
        if (!(distance <= worst)) worst = distance;
    }
    std::printf("%s: %zu rows, at most %.3g from the golden file\n", what.c_str(), found.size(), worst);
    if (!(worst <= tolerance_mm)) throw Error(what + ": further from the golden file than its tolerance");
}

State start_state(const Fields& golden, const Lattice& lattice) {
    State state = at_rest(lattice);
    const Fields start = golden.in("start");
    for (const Json& json : start.list("displacement_mm")) {
        if (!json.is(Json::Kind::array) || json.items.size() != 2) start.fail("has a displacement that is no pair");
        const std::uint64_t node = start.integer(json.items[0], "node number");
        if (node >= lattice.rest.size()) start.fail("moves a node that is not there");
        state.displacement[node] = 1e-3 * start.point(json.items[1], "displacement_mm");
    }
    return state;
}

void check_number(const std::string& what, double found, double expected, double relative) {
    if (!(std::abs(found - expected) <= relative * std::abs(expected)))
        throw Error(what + ": not what the golden file says");
}

void check_landmarks(const Case& bundle, const Fields& checks) {
    const std::vector<Json>& names = checks.list("landmarks");
    if (names.size() != 4) checks.fail("does not name four landmarks");
    const Fields volumes = checks.in("chirality_frames");
    for (const heartcase::Frame& frame : {heartcase::lps, heartcase::gltf, heartcase::unity, heartcase::unreal}) {
        std::array<Point, 4> marks{};
        for (std::size_t n = 0; n < 4; ++n) {
            const auto& all = bundle.manifest.landmarks;
            const auto found = std::find_if(
                all.begin(), all.end(), [&](const heartcase::Landmark& mark) { return mark.name == names[n].text; });
            if (found == all.end()) throw Error("case.json lacks a landmark that the golden file names");
            marks[n] = heartcase::from_lps(frame, found->points_mm[0]);
        }
        heartcase::check_chirality(number(checks, "chirality_lps_mm3"), marks, frame);
        if (volumes.object.find(frame.name) != nullptr)
            check_number("volume of the landmarks", heartcase::signed_volume(marks), number(volumes, frame.name), 1e-6);
    }
}

void check_numbers(const Case& bundle, const Lattice& lattice, const Fields& checks) {
    const Fields counts = checks.in("counts");
    for (const std::string& name : counts.object.keys)
        check_number("counts", static_cast<double>(bundle.count(name)), number(counts, name.c_str()), 0.0);
    double mass_kg = 0.0;
    for (const double mass : lattice.mass) mass_kg += mass;
    check_number("mass of all nodes", 1e3 * mass_kg, number(checks, "mass_g"), 1e-6);
    const std::vector<float> flat = bundle.values<float>("surface", "vertices");
    std::vector<Point> vertices;
    for (std::size_t n = 0; n + 2 < flat.size(); n += 3) vertices.push_back({flat[n], flat[n + 1], flat[n + 2]});
    const double volume = heartcase::enclosed_volume_mm3(bundle.values<std::int32_t>("surface", "triangles"), vertices);
    check_number("volume inside the surface", volume, number(checks, "enclosed_mm3"), 1e-5);
    if (!bundle.has("scan")) return;
    const std::vector<std::int16_t> stored = bundle.values<std::int16_t>("scan", "intensity");
    const heartcase::Geometry& scan = bundle.manifest.scan;
    for (const Json& json : checks.list("scan")) {
        const Fields voxel{json, "a voxel of the golden file"};
        const Point index = voxel.point(voxel.get("index", Json::Kind::array), "index");
        const Point place = voxel.point(voxel.get("lps_mm", Json::Kind::array), "lps_mm");
        const Point gap = scan.point(index[0], index[1], index[2]) - place;
        if (!(dot(gap, gap) <= 1e-10)) voxel.fail("lies elsewhere");
        for (std::size_t axis = 0; axis < 3; ++axis)
            if (!(index[axis] >= 0.0 && index[axis] < static_cast<double>(scan.size[axis])))
                voxel.fail("is not in the scan");
        const double row = index[2] * static_cast<double>(scan.size[1]) + index[1];
        const auto at = static_cast<std::size_t>(row * static_cast<double>(scan.size[0]) + index[0]);
        const double intensity = bundle.manifest.scan_slope * stored[at] + bundle.manifest.scan_intercept;
        if (!(std::abs(intensity - number(voxel, "intensity")) <= 1e-6)) voxel.fail("has another intensity");
    }
}

void run_golden(const Case& bundle, const std::string& path) {
    const heartcase::Bytes text =
        heartcase::read_file(std::filesystem::path(path).parent_path(), std::filesystem::path(path).filename().string(),
                             "the golden file", heartcase::max_manifest_bytes);
    const Json json =
        heartcase::JsonParser::parse({reinterpret_cast<const char*>(text.data()), text.size()}, "the golden file");
    const Fields golden{json, "the golden file"};
    if (golden.text("format") != "heartcase-golden") golden.fail("is not one");
    check_landmarks(bundle, golden.in("checks"));
    const double tolerance_mm = number(golden.in("tolerance_mm"), "float64");
    const double step_s = number(golden, "step_s"), damping = number(golden, "damping_per_s");
    const Point gravity = golden.point(golden.get("gravity_m_s2", Json::Kind::array), "gravity_m_s2");
    const Lattice lattice = heartcase::build_lattice(bundle);
    const heartcase::SurfaceCarrier carrier(bundle, lattice);
    check_surface_at_rest(bundle, lattice, carrier);
    check_numbers(bundle, lattice, golden.in("checks"));
    State state = start_state(golden, lattice);
    const Fields steps = golden.in("steps"), surface = golden.in("surface");
    long last = 0;
    for (const std::string& key : steps.object.keys) last = std::max(last, std::strtol(key.c_str(), nullptr, 10));
    for (const std::string& key : surface.object.keys) last = std::max(last, std::strtol(key.c_str(), nullptr, 10));
    std::size_t compared = 0;
    for (long count = 0; count <= std::min(last, 100'000L); ++count) {
        if (count > 0) heartcase::step(lattice, state, step_s, damping, gravity);
        const std::string key = std::to_string(count), after = " after " + key + " steps";
        if (steps.object.find(key) != nullptr) {
            compare("nodes" + after, node_positions_mm(lattice, state), points(steps.in(key.c_str()), "nodes_mm"),
                    tolerance_mm);
            ++compared;
        }
        if (surface.object.find(key) != nullptr) {
            // A golden file's surface 0 lies over the nodes at rest, not over the start.
            const heartcase::Surface found =
                carrier.over(node_positions_mm(lattice, count == 0 ? at_rest(lattice) : state));
            const Fields expected = surface.in(key.c_str());
            compare("vertices" + after, found.vertices_mm, points(expected, "vertices_mm"), tolerance_mm);
            if (expected.object.find("normals") != nullptr)
                compare("normals" + after, found.normals, points(expected, "normals"), tolerance_mm);
            ++compared;
        }
    }
    if (compared == 0 || compared != steps.object.keys.size() + surface.object.keys.size())
        throw Error("the golden file holds steps that were not compared");
}

void run_steps(const Case& bundle, long count, bool print_nodes) {
    auto start = std::chrono::steady_clock::now();
    const Lattice lattice = heartcase::build_lattice(bundle);
    const heartcase::SurfaceCarrier carrier(bundle, lattice);
    check_surface_at_rest(bundle, lattice, carrier);
    const double build_s = seconds_since(start);
    State state = at_rest(lattice);
    start = std::chrono::steady_clock::now();
    for (long n = 0; n < count; ++n)
        heartcase::step(lattice, state, bundle.manifest.step_default_s, 10.0, {0.0, 0.0, -9.81});
    const double step_s = seconds_since(start);
    const std::vector<Point> nodes = node_positions_mm(lattice, state);
    start = std::chrono::steady_clock::now();
    const heartcase::Surface surface = carrier.over(nodes);
    std::printf("nodes %zu, springs %zu, vertices %zu; build %.4f s, %ld steps %.4f s, surface %.4f s\n", nodes.size(),
                lattice.springs.size(), surface.vertices_mm.size(), build_s, count, step_s, seconds_since(start));
    if (print_nodes)
        for (const Point& p : nodes) std::printf("%.17g %.17g %.17g\n", p[0], p[1], p[2]);
}

}  // namespace

int main(int argc, char** argv) {
    try {
        std::vector<std::string> given(argv + 1, argv + argc);
        const auto take = [&given](const char* option) {
            const auto found = std::find(given.begin(), given.end(), option);
            if (found == given.end()) return false;
            given.erase(found);
            return true;
        };
        const bool print_nodes = take("--nodes"), no_hashes = take("--no-hashes");
        if (given.size() != 2) throw Error("give a case and a golden file, or a case and a number of steps");
        const auto start = std::chrono::steady_clock::now();
        const Case bundle = heartcase::open_case(given[0], {}, !no_hashes);
        std::printf("opened in %.4f s\n", seconds_since(start));
        if (given[1].find_first_not_of("0123456789") == std::string::npos && given[1].size() < 10) {
            run_steps(bundle, std::stol(given[1]), print_nodes);
        } else {
            run_golden(bundle, given[1]);
        }
        return 0;
    } catch (const Error& error) {
        std::fprintf(stderr, "%s\n", error.what());
    } catch (const std::exception&) {
        std::fprintf(stderr, "there is not enough memory, or the case cannot be read\n");
    }
    return 1;
}

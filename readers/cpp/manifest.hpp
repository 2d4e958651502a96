// The manifest of a case, case.json: where the grid lies, how large it is, which files there are.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "coordinates.hpp"
#include "json.hpp"
#include "safetensors.hpp"

namespace heartcase {

constexpr double max_size = 100'000;  // cells along one axis: node keys stay below 2^53

// Lattice of points (centres of cells or voxels): index (i, j, k) lies at origin + direction * (spacing * (i, j, k)).
struct Geometry {
    Point origin_mm{};
    Point spacing_mm{};
    std::array<Point, 3> direction{};  // rows
    std::array<std::int64_t, 3> size{};

    Point point(double i, double j, double k) const {
        const Point step = {spacing_mm[0] * i, spacing_mm[1] * j, spacing_mm[2] * k};
        Point p = origin_mm;
        for (std::size_t row = 0; row < 3; ++row)
            for (std::size_t axis = 0; axis < 3; ++axis) p[row] += direction[row][axis] * step[axis];
        return p;
    }
};

struct FileEntry {
    std::string role, name, sha256;
    std::uint64_t size = 0;
    Json arrays;  // the table of format 1.1, null in 1.0
};

struct Landmark {
    std::string name, kind;
    std::vector<Point> points_mm;
};

struct Manifest {
    Geometry grid, scan;                            // scan: where the voxels of the scan file lie
    double scan_slope = 1.0, scan_intercept = 0.0;  // intensity = slope * stored number + intercept
    double cell_mm = 0.0, step_default_s = 0.0, step_limit_s = 0.0;
    std::uint64_t node_count = 0, cell_count = 0, fixed_node_count = 0;
    std::set<int> label_values;     // the background, 0, is always among them
    std::set<int> material_labels;  // tissue labels that have a material
    bool lists_arrays = false;      // format 1.1 and later: every array stands in the table of its file
    std::vector<FileEntry> files;
    std::vector<Landmark> landmarks;
    Json json;  // everything else
};

// Reads members of the manifest, and says which one is missing or of the wrong kind.
struct Fields {
    const Json& object;
    std::string where;

    [[noreturn]] void fail(const std::string& why) const { throw Error("case.json: " + where + " " + why); }
    const Json& get(const char* key, Json::Kind kind) const {
        const Json* found = object.is(Json::Kind::object) ? object.find(key) : nullptr;
        if (found == nullptr) fail(std::string("lacks ") + key);
        if (!found->is(kind)) fail(std::string("has a ") + key + " of the wrong kind");
        return *found;
    }
    Fields in(const char* key) const { return {get(key, Json::Kind::object), where + "." + key}; }
    const std::vector<Json>& list(const char* key) const { return get(key, Json::Kind::array).items; }
    const std::string& text(const char* key) const { return get(key, Json::Kind::string).text; }
    double positive(const char* key) const {
        const double value = get(key, Json::Kind::number).number;
        if (!(value > 0.0)) fail(std::string("has a ") + key + " that is not positive");
        return value;
    }
    std::uint64_t integer(const Json& json, const char* key) const {
        if (!is_count(json)) fail(std::string("has a ") + key + " that is not a whole number from 0 up");
        return static_cast<std::uint64_t>(json.number);
    }
    std::uint64_t integer(const char* key) const { return integer(get(key, Json::Kind::number), key); }
    Point point(const Json& json, const char* key) const {
        if (!json.is(Json::Kind::array) || json.items.size() != 3)
            fail(std::string("has a ") + key + " that is not three numbers");
        Point p{};
        for (std::size_t n = 0; n < 3; ++n) {
            if (!json.items[n].is(Json::Kind::number)) fail(std::string("has a ") + key + " that is not three numbers");
            p[n] = json.items[n].number;
        }
        return p;
    }
};

inline Geometry read_geometry(const Fields& fields) {
    Geometry geometry;
    geometry.origin_mm = fields.point(fields.get("origin_mm", Json::Kind::array), "origin_mm");
    geometry.spacing_mm = fields.point(fields.get("spacing_mm", Json::Kind::array), "spacing_mm");
    const std::vector<Json>& rows = fields.list("direction");
    const std::vector<Json>& size = fields.list("size");
    if (rows.size() != 3 || size.size() != 3) fields.fail("must have three axes");
    for (std::size_t n = 0; n < 3; ++n) {
        geometry.direction[n] = fields.point(rows[n], "direction");
        const std::uint64_t points = fields.integer(size[n], "size");
        if (points < 1 || static_cast<double>(points) > max_size) fields.fail("has a size out of range");
        geometry.size[n] = static_cast<std::int64_t>(points);
        if (!(geometry.spacing_mm[n] > 0.0)) fields.fail("has a spacing_mm that is not positive");
    }
    const auto& d = geometry.direction;
    for (std::size_t a = 0; a < 3; ++a)
        for (std::size_t b = 0; b < 3; ++b) {
            const double product = d[0][a] * d[0][b] + d[1][a] * d[1][b] + d[2][a] * d[2][b];
            if (!(std::abs(product - (a == b ? 1.0 : 0.0)) < 1e-4))
                fields.fail("has a direction whose axes are not unit and square");
        }
    return geometry;
}

// The grid's cells are cubes and its axes right-handed; a scan's need not be.
inline Geometry read_grid_geometry(const Fields& fields) {
    const Geometry geometry = read_geometry(fields);
    const auto& d = geometry.direction;
    for (std::size_t n = 0; n < 3; ++n)
        if (std::abs(geometry.spacing_mm[n] - geometry.spacing_mm[0]) > 1e-6 * geometry.spacing_mm[0])
            fields.fail("has cells that are not cubes");
    if (!(dot(d[0], cross(d[1], d[2])) > 0.0)) fields.fail("is left-handed: the case is mirrored");
    return geometry;
}

// A lower-case name of letters, digits, '_', '.', '-' that begins with a letter or digit: never a path.
inline bool is_plain_name(const std::string& name) {
    const auto plain = [](char c) { return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9'); };
    if (name.empty() || name.size() > 128 || !plain(name[0])) return false;
    return std::all_of(name.begin(), name.end(), [&](char c) { return plain(c) || c == '_' || c == '.' || c == '-'; });
}

inline std::vector<FileEntry> read_file_entries(const Fields& manifest) {
    std::vector<FileEntry> entries;
    std::set<std::string> names, roles;
    for (const Json& json : manifest.list("files")) {
        const Fields fields{json, "entry " + std::to_string(entries.size() + 1) + " of files"};
        FileEntry entry{fields.text("role"), fields.text("name"), fields.text("sha256"), fields.integer("size"), {}};
        if (!is_plain_name(entry.name) || entry.name == "case.json")
            fields.fail("has a name that is not a plain file name");
        if (!names.insert(entry.name).second) fields.fail("has the name of an entry before it");
        if (!roles.insert(entry.role).second) fields.fail("has the role of an entry before it");
        const auto hex = [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); };
        if (entry.sha256.size() != 64 || !std::all_of(entry.sha256.begin(), entry.sha256.end(), hex))
            fields.fail("has a sha256 that is not one");
        if (const Json* table = json.find("arrays")) entry.arrays = *table;
        entries.push_back(std::move(entry));
    }
    return entries;
}

// The axes are part of the format: a case that states others would be shown turned or mirrored.
inline void check_frames(const Fields& fields, bool must_state) {
    const auto same = [](const Fields& where, const Json& rows, const Frame& frame) {
        if (!rows.is(Json::Kind::array) || rows.items.size() != 3) where.fail("has a matrix that is not 3 x 3");
        for (std::size_t n = 0; n < 3; ++n) {
            const Point row = where.point(rows.items[n], "matrix");
            for (std::size_t axis = 0; axis < 3; ++axis)
                if (row[axis] != frame.from_lps_mm[n][axis])
                    where.fail("has a matrix that the format does not allow: the case would be turned or mirrored");
        }
    };
    if (const Json* rows = fields.object.find("gltf_from_lps")) same(fields, *rows, gltf);
    if (!must_state && fields.object.find("coordinates") == nullptr) return;
    const Fields coordinates = fields.in("coordinates");
    const std::pair<const char*, const char*> fixed[] = {{"space", "patient LPS"},
                                                         {"unit", "mm"},
                                                         {"handedness", "right"},
                                                         {"winding", "counter-clockwise from outside the tissue"}};
    for (const auto& [key, value] : fixed)
        if (coordinates.text(key) != value)
            coordinates.fail(std::string("has a ") + key + " that the format does not allow");
    const std::vector<Json>& axes = coordinates.list("axes");
    if (axes.size() != 3 || axes[0].text != "left" || axes[1].text != "back" || axes[2].text != "head")
        coordinates.fail("has axes that the format does not allow");
    for (const Json& json : coordinates.list("frames")) {
        const Fields entry{json, "a frame of coordinates"};
        for (const Frame& frame : {gltf, unity, unreal}) {
            if (entry.text("name") != frame.name) continue;
            same(entry, entry.get("from_lps_mm", Json::Kind::array), frame);
            if (entry.text("handedness") != (frame.left_handed ? "left" : "right"))
                entry.fail("has the wrong handedness");
            if (entry.get("reverse_triangles", Json::Kind::boolean).boolean != frame.reverse_triangles)
                entry.fail("turns its triangles the wrong way");
        }
    }
}

// Returns whether every array must stand in the manifest's tables: from 1.1 on.
inline bool check_format(const Fields& fields) {
    if (fields.text("format") != "heartcase-bundle") fields.fail("is not a heartcase bundle");
    const std::string& version = fields.text("format_version");
    const std::size_t dot = version.find('.');
    const auto digits = [](const std::string& text) {
        return !text.empty() && text.size() < 10 && text.find_first_not_of("0123456789") == std::string::npos;
    };
    if (dot == std::string::npos || !digits(version.substr(0, dot)) || !digits(version.substr(dot + 1)))
        fields.fail("has a format_version that is not MAJOR.MINOR");
    if (version.substr(0, dot) != "1") fields.fail("has a format_version that this reader does not know: it reads 1.x");
    const Json* extensions = fields.object.find("required_extensions");
    if (extensions != nullptr && (!extensions->is(Json::Kind::array) || !extensions->items.empty()))
        fields.fail("requires an extension that this reader does not know");
    return version.find_first_not_of('0', dot + 1) != std::string::npos;
}

inline Manifest read_manifest(std::string_view text) {
    Manifest manifest;
    manifest.json = JsonParser::parse(text, "case.json");
    const Fields fields{manifest.json, "the manifest"};
    manifest.lists_arrays = check_format(fields);
    check_frames(fields, manifest.lists_arrays);
    manifest.grid = read_grid_geometry(fields.in("grid_geometry"));
    manifest.scan = read_geometry(fields.in("scan_geometry"));
    const Json* scan_values = manifest.json.find("scan_values");
    if (scan_values != nullptr && !scan_values->is(Json::Kind::null)) {
        manifest.scan_slope = fields.in("scan_values").positive("slope");
        manifest.scan_intercept = fields.in("scan_values").get("intercept", Json::Kind::number).number;
    }
    const Fields simulation = fields.in("simulation");
    manifest.cell_mm = simulation.positive("cell_mm");
    manifest.step_default_s = simulation.positive("step_default_s");
    manifest.step_limit_s = simulation.positive("step_limit_s");
    manifest.node_count = simulation.integer("node_count");
    manifest.cell_count = simulation.integer("cell_count");
    manifest.fixed_node_count = simulation.integer("fixed_node_count");
    if (std::abs(manifest.cell_mm - manifest.grid.spacing_mm[0]) > 1e-6 * manifest.cell_mm)
        simulation.fail("has a cell_mm that is not the grid's spacing");
    if (manifest.step_default_s > manifest.step_limit_s) simulation.fail("has a step_default_s beyond step_limit_s");
    manifest.label_values.insert(0);
    for (const Json& json : fields.in("labels").list("labels")) {
        const Fields label{json, "a label"};
        manifest.label_values.insert(static_cast<int>(std::min<std::uint64_t>(label.integer("value"), 255)));
    }
    for (const Json& json : fields.list("materials"))
        manifest.material_labels.insert(
            static_cast<int>(std::min<std::uint64_t>(Fields{json, "a material"}.integer("label"), 255)));
    manifest.files = read_file_entries(fields);
    if (manifest.json.find("landmarks") != nullptr)
        for (const Json& json : fields.list("landmarks")) {
            const Fields entry{json, "a landmark"};
            Landmark landmark{entry.text("name"), entry.text("kind"), {}};
            for (const Json& p : entry.list("points_mm")) landmark.points_mm.push_back(entry.point(p, "points_mm"));
            if (landmark.points_mm.empty()) entry.fail("has no point");
            manifest.landmarks.push_back(std::move(landmark));
        }
    return manifest;
}

}  // namespace heartcase

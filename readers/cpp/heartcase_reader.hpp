// Reader of heartcase case bundles, format 1.x, in C++17, with nothing but the standard library.
//
//   heartcase::Case bundle = heartcase::open_case("heart.case", {"grid", "surface", "mapping"});
//   std::vector<std::int32_t> cells = bundle.values<std::int32_t>("grid", "cells");  // (cell_count, 3), row by row
//
// Written from docs/bundle.md and docs/schemas/bundle-arrays.json. A file is judged before it is used: whatever is
// wrong is thrown as heartcase::Error, one line that holds no text of the file. Space is patient LPS in mm.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "manifest.hpp"
#include "safetensors.hpp"
#include "sha256.hpp"

namespace heartcase {

constexpr std::uintmax_t max_manifest_bytes = 16u << 20;

struct ArrayRule {
    const char* role;
    const char* name;
    const char* dtype;               // as safetensors writes it
    std::vector<std::string> shape;  // a number, or the name of a count that arrays share
};

// docs/schemas/bundle-arrays.json
inline const std::vector<ArrayRule>& array_rules() {
    static const std::vector<ArrayRule> rules = {
        {"grid", "cells", "I32", {"cell_count", "3"}},
        {"grid", "cell_coverage", "F32", {"cell_count"}},
        {"grid", "cell_label", "U8", {"cell_count"}},
        {"grid", "cell_stiffness", "F32", {"cell_count"}},
        {"grid", "cell_density", "F32", {"cell_count"}},
        {"grid", "nodes", "I32", {"node_count", "3"}},
        {"grid", "fixed", "U8", {"node_count"}},
        {"surface", "vertices", "F32", {"vertex_count", "3"}},
        {"surface", "normals", "F32", {"vertex_count", "3"}},
        {"surface", "triangles", "I32", {"triangle_count", "3"}},
        {"surface", "triangle_label", "U8", {"triangle_count"}},
        {"surface", "triangle_tissue", "U8", {"triangle_count"}},
        {"surface", "triangle_is_cut", "U8", {"triangle_count"}},
        {"surface", "vertex_label", "U8", {"vertex_count"}},
        {"surface", "render_to_welded", "I32", {"render_vertex_count"}},
        {"mapping", "triangle_nodes", "I32", {"vertex_count", "3"}},
        {"mapping", "weights", "F32", {"vertex_count", "3"}},
        {"mapping", "offset", "F32", {"vertex_count", "3"}},
        {"mapping", "normal", "F32", {"vertex_count", "3"}},
        {"mapping", "curvature", "U8", {"vertex_count"}},
        {"mapping", "tangent", "F32", {"render_vertex_count", "4"}},
        {"mapping", "nearest_node", "I32", {"vertex_count"}},
        {"picking", "nodes", "I32", {"picking_vertex_count"}},
        {"picking", "triangles", "I32", {"picking_triangle_count", "3"}},
        {"picking", "triangle_label", "U8", {"picking_triangle_count"}},
        {"scan", "intensity", "I16", {"scan_k", "scan_j", "scan_i"}},
    };
    return rules;
}

inline bool holds_arrays(const std::string& role) {
    const auto& rules = array_rules();
    return std::any_of(rules.begin(), rules.end(), [&role](const ArrayRule& rule) { return role == rule.role; });
}

struct Case {
    Manifest manifest;
    std::map<std::string, Arrays> files;          // by role, for the roles that were asked for
    std::map<std::string, std::uint64_t> counts;  // cell_count, node_count, vertex_count, ...

    bool has(const std::string& role) const { return files.count(role) > 0; }
    const Array& array(const std::string& role, const std::string& name) const {
        const auto file = files.find(role);
        if (file == files.end()) throw Error("the " + role + " file was not read");
        const auto found = file->second.find(name);
        if (found == file->second.end()) throw Error("the " + role + " file lacks " + name);
        return found->second;
    }
    template <class T>
    std::vector<T> values(const std::string& role, const std::string& name) const {
        return array(role, name).values<T>();
    }
    std::uint64_t count(const std::string& name) const {
        const auto found = counts.find(name);
        return found == counts.end() ? 0 : found->second;
    }
};

// The whole of a plain file of `folder`; never follows a link.
inline Bytes read_file(const std::filesystem::path& folder, const std::string& name, const std::string& what,
                       std::uintmax_t most) {
    std::error_code error;
    const std::filesystem::path path = folder / name;
    if (std::filesystem::symlink_status(path, error).type() != std::filesystem::file_type::regular)
        throw Error(what + " is missing or no plain file");
    const std::uintmax_t size = std::filesystem::file_size(path, error);
    if (error) throw Error(what + " cannot be read");
    if (size > most) throw Error(what + " is larger than allowed");
    std::ifstream stream(path, std::ios::binary);
    Bytes bytes(static_cast<std::size_t>(size));
    stream.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(size));
    if (!stream || static_cast<std::uintmax_t>(stream.gcount()) != size) throw Error(what + " cannot be read");
    return bytes;
}

// Type, shape and count of every array of the table; `counts` is shared by all files of the case.
inline void check_shapes(const std::string& role, const Arrays& arrays, std::map<std::string, std::uint64_t>& counts) {
    for (const ArrayRule& rule : array_rules()) {
        if (role != rule.role) continue;
        const std::string where = "the " + role + " file: " + rule.name;
        const auto found = arrays.find(rule.name);
        if (found == arrays.end()) throw Error(where + " is missing");
        const Array& array = found->second;
        if (array.dtype != rule.dtype) throw Error(where + " has the wrong type, " + rule.dtype + " is expected");
        if (array.shape.size() != rule.shape.size()) throw Error(where + " has the wrong shape");
        for (std::size_t axis = 0; axis < rule.shape.size(); ++axis) {
            const std::string& name = rule.shape[axis];
            const bool is_number = name.size() == 1;
            const std::uint64_t wanted = is_number ? static_cast<std::uint64_t>(name[0] - '0')
                                                   : counts.emplace(name, array.shape[axis]).first->second;
            if (array.shape[axis] != wanted)
                throw Error(where + (is_number ? " has the wrong shape" : " has not as many rows as its " + name));
        }
    }
}

// The manifest's table of arrays (from format 1.1 on) must say what the file's header says.
inline void check_table(const FileEntry& entry, const Arrays& arrays, bool lists_arrays) {
    static const std::map<std::string, std::string> types = {
        {"int32", "I32"}, {"int16", "I16"}, {"float32", "F32"}, {"uint8", "U8"}};
    const std::string where = "case.json: the table of arrays of the " + entry.role + " file";
    if (!lists_arrays) return;
    if (!entry.arrays.is(Json::Kind::array)) throw Error(where + " is missing");
    std::set<std::string> listed;
    for (const Json& json : entry.arrays.items) {
        const Fields row{json, "a row of the table of arrays"};
        const auto found = arrays.find(row.text("name"));
        if (found == arrays.end()) throw Error(where + " names an array that the file lacks");
        listed.insert(found->first);
        const Array& array = found->second;
        const auto type = types.find(row.text("dtype"));
        const std::vector<Json>& shape = row.list("shape");
        bool same = type != types.end() && type->second == array.dtype && row.integer("offset") == array.begin &&
                    shape.size() == array.shape.size();
        for (std::size_t n = 0; same && n < shape.size(); ++n) same = row.integer(shape[n], "shape") == array.shape[n];
        if (!same) throw Error(where + " does not agree with the file's header");
        if (array.begin % 64 != 0) throw Error(where + " has an array that does not start at a multiple of 64 bytes");
    }
    for (const ArrayRule& rule : array_rules())
        if (entry.role == rule.role && listed.count(rule.name) == 0) throw Error(where + " leaves out " + rule.name);
}

// Every value of an array must satisfy `ok`, or the message says which does not and what the rule is.
template <class T, class Ok>
void check_values(const Case& bundle, const char* role, const char* name, const char* rule, Ok ok) {
    const std::vector<T> values = bundle.values<T>(role, name);
    for (std::size_t n = 0; n < values.size(); ++n)
        if (!ok(values[n], n))
            throw Error(std::string("the ") + role + " file: " + name + " must be " + rule + ", value " +
                        std::to_string(n + 1) + " is not");
}

inline void check_below(const Case& bundle, const char* role, const char* name, const char* of) {
    const auto limit = static_cast<std::int64_t>(bundle.count(of));
    const std::string rule = std::string("from 0 up to below the ") + of;
    check_values<std::int32_t>(bundle, role, name, rule.c_str(),
                               [limit](std::int32_t v, std::size_t) { return v >= 0 && v < limit; });
}

// Rows of (i, j, k) lie in the box of `size` and ascend by k, then j, then i; returns one ascending key per row.
inline std::vector<std::int64_t> keys_of(const Case& bundle, const char* name,
                                         const std::array<std::int64_t, 3>& size) {
    const std::vector<std::int32_t> rows = bundle.values<std::int32_t>("grid", name);
    std::vector<std::int64_t> keys(rows.size() / 3);
    for (std::size_t n = 0; n < keys.size(); ++n) {
        for (std::size_t axis = 0; axis < 3; ++axis)
            if (rows[3 * n + axis] < 0 || rows[3 * n + axis] >= size[axis])
                throw Error(std::string("the grid file: ") + name + " lie outside the grid in row " +
                            std::to_string(n + 1));
        keys[n] = (rows[3 * n + 2] * size[1] + rows[3 * n + 1]) * size[0] + rows[3 * n];
        if (n > 0 && keys[n] <= keys[n - 1])
            throw Error(std::string("the grid file: ") + name + " do not ascend by k, j, i in row " +
                        std::to_string(n + 1));
    }
    return keys;
}

// Where in its cell the tissue lies (from format 1.3 on): means of x, y, z, xx, yy, zz, yz, xz, xy from its centre. The
// springs do not ask for it, other force laws do.
inline void check_moments(const Case& bundle) {
    const Array& array = bundle.array("grid", "cell_moments");
    const std::string where = "the grid file: cell_moments has ";
    if (array.dtype != "F32") throw Error(where + "the wrong type, F32 is expected");
    if (array.shape.size() != 2 || array.shape[0] != bundle.count("cell_count") || array.shape[1] != 9)
        throw Error(where + "the wrong shape");
    check_values<float>(bundle, "grid", "cell_moments", "from -1/2 to 1/2",
                        [](float v, std::size_t) { return std::abs(v) <= 0.5F; });
    const std::vector<float> values = bundle.values<float>("grid", "cell_moments");
    for (std::size_t n = 0; n < values.size(); n += 9)
        for (std::size_t axis = n; axis < n + 3; ++axis)
            if (values[axis + 3] < double{values[axis]} * values[axis] - 1e-6)
                throw Error(where + "means of squares below the squares of the means in row " +
                            std::to_string(n / 9 + 1));
}

inline void check_grid(const Case& bundle) {
    const Manifest& m = bundle.manifest;
    if (bundle.count("cell_count") != m.cell_count || bundle.count("node_count") != m.node_count || m.cell_count == 0)
        throw Error("the grid file has not the cells and nodes that case.json counts");
    check_values<float>(bundle, "grid", "cell_coverage", "above 0 and at most 1",
                        [](float v, std::size_t) { return v > 0.0F && v <= 1.0F; });
    check_values<float>(bundle, "grid", "cell_stiffness", "above 0 and at most 1e6 kPa",
                        [](float v, std::size_t) { return v > 0.0F && v <= 1e6F; });
    check_values<float>(bundle, "grid", "cell_density", "above 0 and at most 2e4 kg/m3",
                        [](float v, std::size_t) { return v > 0.0F && v <= 2e4F; });
    check_values<std::uint8_t>(
        bundle, "grid", "cell_label", "a label that has a material",
        [&m](std::uint8_t v, std::size_t) { return m.label_values.count(v) > 0 && m.material_labels.count(v) > 0; });
    if (bundle.files.at("grid").count("cell_moments") > 0) check_moments(bundle);
    std::uint64_t fixed = 0;
    check_values<std::uint8_t>(bundle, "grid", "fixed", "0 or 1",
                               [&fixed](std::uint8_t v, std::size_t) { return fixed += v, v <= 1; });
    if (fixed != m.fixed_node_count)
        throw Error("the grid file holds another number of nodes fixed than case.json counts");
    if (fixed == m.node_count) throw Error("the grid file holds no node that may move");
    const auto& s = m.grid.size;
    keys_of(bundle, "cells", s);
    const std::array<std::int64_t, 3> node_size = {s[0] + 1, s[1] + 1, s[2] + 1};
    const std::vector<std::int64_t> nodes = keys_of(bundle, "nodes", node_size);
    const std::vector<std::int32_t> cells = bundle.values<std::int32_t>("grid", "cells");
    std::vector<bool> used(nodes.size());
    for (std::size_t c = 0; c + 2 < cells.size(); c += 3)
        for (int corner = 0; corner < 8; ++corner) {
            const std::int64_t i = cells[c] + (corner & 1), j = cells[c + 1] + (corner >> 1 & 1),
                               k = cells[c + 2] + (corner >> 2);
            const std::int64_t key = (k * node_size[1] + j) * node_size[0] + i;
            const auto found = std::lower_bound(nodes.begin(), nodes.end(), key);
            if (found == nodes.end() || *found != key)
                throw Error("the grid file: a corner of cell " + std::to_string(c / 3 + 1) + " is not among the nodes");
            used[static_cast<std::size_t>(found - nodes.begin())] = true;
        }
    if (std::find(used.begin(), used.end(), false) != used.end())
        throw Error("the grid file: a node is the corner of no cell");
}

inline void check_other_files(const Case& bundle) {
    const auto finite = [](float v, std::size_t) { return std::isfinite(v); };
    const auto flag = [](std::uint8_t v, std::size_t) { return v <= 1; };
    const auto label = [&bundle](std::uint8_t v, std::size_t) { return bundle.manifest.label_values.count(v) > 0; };
    if (bundle.has("surface")) {
        for (const char* name : {"vertices", "normals"}) check_values<float>(bundle, "surface", name, "finite", finite);
        for (const char* name : {"triangle_label", "triangle_tissue", "vertex_label"})
            check_values<std::uint8_t>(bundle, "surface", name, "a label of case.json", label);
        check_values<std::uint8_t>(bundle, "surface", "triangle_is_cut", "0 or 1", flag);
        check_below(bundle, "surface", "triangles", "vertex_count");
        check_below(bundle, "surface", "render_to_welded", "vertex_count");
    }
    if (bundle.has("mapping")) {
        for (const char* name : {"weights", "offset", "normal", "tangent"})
            check_values<float>(bundle, "mapping", name, "finite", finite);
        check_values<std::uint8_t>(bundle, "mapping", "curvature", "0 or 1", flag);
        check_below(bundle, "mapping", "triangle_nodes", "node_count");
        check_below(bundle, "mapping", "nearest_node", "node_count");
        const std::vector<float> w = bundle.values<float>("mapping", "weights");
        for (std::size_t v = 0; v + 2 < w.size(); v += 3)
            if (!(std::abs(double{w[v]} + w[v + 1] + w[v + 2] - 1.0) < 1e-4))
                throw Error("the mapping file: weights of vertex " + std::to_string(v / 3 + 1) +
                            " do not add up to one");
    }
    if (bundle.has("picking")) {
        check_below(bundle, "picking", "nodes", "node_count");
        check_below(bundle, "picking", "triangles", "picking_vertex_count");
        check_values<std::uint8_t>(bundle, "picking", "triangle_label", "a label of case.json", label);
    }
    if (bundle.has("scan")) {
        Fields{bundle.manifest.json, "the manifest"}.in("scan_values");
        const char* counts[3] = {"scan_i", "scan_j", "scan_k"};
        for (std::size_t axis = 0; axis < 3; ++axis)
            if (bundle.count(counts[axis]) != static_cast<std::uint64_t>(bundle.manifest.scan.size[axis]))
                throw Error("the scan file: intensity has not the shape of scan_geometry");
    }
}

// Opens the case in `folder` and reads the grid and the files of `roles` (surface, mapping, picking, scan), or all that
// it lists where no role is given; of files without arrays (render, labels) only size and hash are judged. With
// check_hashes every file that is read must have its SHA-256; without it only structure and ranges are checked.
inline Case open_case(const std::filesystem::path& folder, std::vector<std::string> roles = {},
                      bool check_hashes = true) {
    Case bundle;
    const Bytes text = read_file(folder, "case.json", "case.json", max_manifest_bytes);
    bundle.manifest = read_manifest({reinterpret_cast<const char*>(text.data()), text.size()});
    const auto& entries = bundle.manifest.files;
    if (roles.empty())
        for (const FileEntry& entry : entries) roles.push_back(entry.role);
    roles.insert(roles.begin(), "grid");
    for (const std::string& role : roles) {
        if (bundle.has(role)) continue;
        const auto entry =
            std::find_if(entries.begin(), entries.end(), [&role](const FileEntry& e) { return e.role == role; });
        const bool known = holds_arrays(role) || role == "render" || role == "labels";
        if (entry == entries.end())
            throw Error(known ? "case.json lists no " + role + " file" : "a role that was asked for is not known");
        const std::string what = known ? "the " + role + " file" : "a file of another role";
        const auto bytes = std::make_shared<const Bytes>(read_file(folder, entry->name, what, entry->size));
        if (bytes->size() != entry->size) throw Error(what + " has not the size that case.json states");
        if (check_hashes && sha256(bytes->data(), bytes->size()) != entry->sha256)
            throw Error(what + " has not the SHA-256 that case.json states");
        if (!holds_arrays(role)) continue;
        Arrays arrays = read_safetensors(bytes, what);
        check_shapes(role, arrays, bundle.counts);
        check_table(*entry, arrays, bundle.manifest.lists_arrays);
        bundle.files.emplace(role, std::move(arrays));
    }
    check_grid(bundle);
    check_other_files(bundle);
    return bundle;
}

}  // namespace heartcase

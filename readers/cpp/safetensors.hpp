// Arrays of a safetensors file: length of the header (8 bytes, little-endian), header (JSON), data (little-endian, C
// order).

#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "json.hpp"

namespace heartcase {

static_assert(std::numeric_limits<float>::is_iec559 && sizeof(float) == 4, "arrays are IEEE 754");

using Bytes = std::vector<unsigned char>;

constexpr std::uint64_t max_header_bytes = 1u << 20;
constexpr double max_exact_integer = 9007199254740991.0;  // 2^53 - 1

inline bool is_count(const Json& json) {
    return json.is(Json::Kind::number) && json.number >= 0.0 && json.number <= max_exact_integer &&
           json.number == std::floor(json.number);
}

// One array. It keeps the file's bytes alive; `begin` need not be aligned for the type.
struct Array {
    std::shared_ptr<const Bytes> file;
    std::string dtype;  // as safetensors writes it: I32, F32, U8, ...
    std::vector<std::uint64_t> shape;
    std::uint64_t begin = 0;  // bytes from the start of the file
    std::uint64_t count = 0;  // values

    // All values in C order, T being float, std::int32_t, std::int16_t or std::uint8_t.
    template <class T>
    std::vector<T> values() const {
        constexpr bool is_float = std::is_same_v<T, float>, is_int = std::is_same_v<T, std::int32_t>;
        constexpr bool is_short = std::is_same_v<T, std::int16_t>, is_byte = std::is_same_v<T, std::uint8_t>;
        static_assert(is_float || is_int || is_short || is_byte);
        const char* wanted = is_float ? "F32" : is_int ? "I32" : is_short ? "I16" : "U8";
        if (dtype != wanted) throw Error(std::string("an array is read as ") + wanted + ", which is not its type");
        std::vector<T> result(static_cast<std::size_t>(count));
        if (count > 0) std::memcpy(result.data(), file->data() + begin, result.size() * sizeof(T));
        const std::uint16_t probe = 1;
        unsigned char low = 0;
        std::memcpy(&low, &probe, 1);
        if (low == 0)  // a big-endian host
            for (T& value : result) {
                auto* bytes = reinterpret_cast<unsigned char*>(&value);
                std::reverse(bytes, bytes + sizeof(T));
            }
        return result;
    }
};

using Arrays = std::map<std::string, Array>;

// Bytes of one value, 0 for a type that is not known.
inline std::uint64_t item_size(std::string_view dtype) {
    if (dtype == "BOOL" || dtype == "U8" || dtype == "I8") return 1;
    if (dtype == "U16" || dtype == "I16" || dtype == "F16" || dtype == "BF16") return 2;
    if (dtype == "U32" || dtype == "I32" || dtype == "F32") return 4;
    if (dtype == "U64" || dtype == "I64" || dtype == "F64") return 8;
    return 0;
}

// Judges one entry of the header against the size of the data; throws Error, which begins with `where`.
inline Array read_array_entry(const Json& entry, std::uint64_t data_start, std::uint64_t data_size,
                              const std::string& where) {
    const Json* dtype = entry.find("dtype");
    const Json* shape = entry.find("shape");
    const Json* offsets = entry.find("data_offsets");
    if (dtype == nullptr || shape == nullptr || offsets == nullptr)
        throw Error(where + "lacks dtype, shape or data_offsets");
    Array array;
    array.dtype = dtype->text;
    array.count = 1;
    const std::uint64_t bytes = item_size(array.dtype);
    if (bytes == 0) throw Error(where + "has a type that is not known");
    if (!shape->is(Json::Kind::array) || shape->items.size() > 8) throw Error(where + "has a shape that is not one");
    for (const Json& axis : shape->items) {
        if (!is_count(axis)) throw Error(where + "has a shape that is not one");
        array.shape.push_back(static_cast<std::uint64_t>(axis.number));
        if (array.shape.back() != 0 && array.count > data_size / array.shape.back())
            throw Error(where + "is larger than its file");
        array.count *= array.shape.back();
    }
    if (!offsets->is(Json::Kind::array) || offsets->items.size() != 2 || !is_count(offsets->items[0]) ||
        !is_count(offsets->items[1]))
        throw Error(where + "has data_offsets that are not two counts");
    const auto begin = static_cast<std::uint64_t>(offsets->items[0].number);
    const auto end = static_cast<std::uint64_t>(offsets->items[1].number);
    if (begin > end || end > data_size) throw Error(where + "lies outside its file");
    if ((end - begin) % bytes != 0 || (end - begin) / bytes != array.count)
        throw Error(where + "has data_offsets that do not fit its shape");
    array.begin = data_start + begin;
    return array;
}

// All arrays of a file. `what` names it in messages, for example "the grid file". Arrays must lie one behind the other,
// without gap or overlap, as the safetensors format demands.
inline Arrays read_safetensors(const std::shared_ptr<const Bytes>& file, const std::string& what) {
    const Bytes& bytes = *file;
    if (bytes.size() < 8) throw Error(what + " is too short for a safetensors file");
    std::uint64_t header_size = 0;
    for (int n = 7; n >= 0; --n) header_size = header_size << 8 | bytes[static_cast<std::size_t>(n)];
    if (header_size > max_header_bytes || header_size > bytes.size() - 8)
        throw Error(what + " has a header longer than allowed or than the file");
    const std::uint64_t data_start = 8 + header_size;
    const std::string_view text(reinterpret_cast<const char*>(bytes.data()) + 8, static_cast<std::size_t>(header_size));
    const Json header = JsonParser::parse(text, "the header of " + what);
    if (!header.is(Json::Kind::object)) throw Error(what + " has a header that is not an object");
    Arrays arrays;
    std::vector<std::pair<std::uint64_t, std::uint64_t>> spans;
    for (std::size_t n = 0; n < header.keys.size(); ++n) {
        if (header.keys[n] == "__metadata__") continue;
        const std::string where = what + ": array " + std::to_string(n + 1) + " of the header ";
        Array array = read_array_entry(header.items[n], data_start, bytes.size() - data_start, where);
        array.file = file;
        spans.emplace_back(array.begin, array.begin + array.count * item_size(array.dtype));
        arrays.emplace(header.keys[n], std::move(array));
    }
    std::sort(spans.begin(), spans.end());
    std::uint64_t end = data_start;
    for (const auto& span : spans) {
        if (span.first != end) throw Error(what + " has arrays that overlap or leave a gap");
        end = span.second;
    }
    if (end != bytes.size()) throw Error(what + " has data that no array holds");
    return arrays;
}

}  // namespace heartcase

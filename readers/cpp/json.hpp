// JSON (RFC 8259) of bounded size, depth and number of values; duplicate keys are refused.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <locale>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace heartcase {

// What is wrong with a case, in one line without any text of its files.
struct Error : std::runtime_error {
    using std::runtime_error::runtime_error;
};

struct Json {
    enum class Kind { null, boolean, number, string, array, object };

    Kind kind = Kind::null;
    bool boolean = false;
    double number = 0.0;
    std::string text;
    std::vector<std::string> keys;  // of an object, in the order of the file
    std::vector<Json> items;        // of an array; the values of an object

    const Json* find(std::string_view key) const {
        for (std::size_t n = 0; n < keys.size(); ++n)
            if (keys[n] == key) return &items[n];
        return nullptr;
    }
    bool is(Kind wanted) const { return kind == wanted; }
};

class JsonParser {
public:
    static constexpr int max_depth = 64;
    static constexpr std::size_t max_values = 1'000'000;

    // `what` names the text in messages, for example "case.json".
    static Json parse(std::string_view text, const std::string& what) {
        JsonParser parser(text, what);
        Json value = parser.value(0);
        parser.skip_space();
        if (parser.at_ != text.size()) parser.fail("text after the end");
        return value;
    }

private:
    JsonParser(std::string_view text, const std::string& what) : text_(text), what_(what) {}

    [[noreturn]] void fail(const char* why) const {
        throw Error(what_ + " is not valid JSON: " + why + " at byte " + std::to_string(at_));
    }
    bool peek(char wanted) const { return at_ < text_.size() && text_[at_] == wanted; }
    void skip_space() {
        while (at_ < text_.size() && std::string_view(" \t\r\n").find(text_[at_]) != std::string_view::npos) ++at_;
    }
    void expect(char wanted, const char* why) {
        skip_space();
        if (!peek(wanted)) fail(why);
        ++at_;
    }
    bool take_word(std::string_view word) {
        if (text_.substr(at_, word.size()) != word) return false;
        at_ += word.size();
        return true;
    }

    Json value(int depth) {
        if (++count_ > max_values) fail("too many values");
        skip_space();
        if (depth >= max_depth && (peek('{') || peek('['))) fail("too deep");
        Json json;
        if (peek('{')) {
            object(json, depth);
        } else if (peek('[')) {
            array(json, depth);
        } else if (peek('"')) {
            json.kind = Json::Kind::string;
            json.text = string();
        } else if (take_word("true") || take_word("false")) {
            json.kind = Json::Kind::boolean;
            json.boolean = text_[at_ - 2] == 'u';  // tr(u)e, fal(s)e
        } else if (!take_word("null")) {
            json.kind = Json::Kind::number;
            json.number = number();
        }
        return json;
    }

    void array(Json& json, int depth) {
        json.kind = Json::Kind::array;
        ++at_;
        skip_space();
        if (peek(']')) {
            ++at_;
            return;
        }
        for (;;) {
            json.items.push_back(value(depth + 1));
            skip_space();
            if (!peek(',')) break;
            ++at_;
        }
        expect(']', "a list does not end");
    }

    void object(Json& json, int depth) {
        json.kind = Json::Kind::object;
        ++at_;
        skip_space();
        if (peek('}')) {
            ++at_;
            return;
        }
        for (;;) {
            skip_space();
            if (!peek('"')) fail("a key is missing");
            std::string key = string();
            expect(':', "a value is missing");
            json.items.push_back(value(depth + 1));
            json.keys.push_back(std::move(key));
            skip_space();
            if (!peek(',')) break;
            ++at_;
        }
        expect('}', "an object does not end");
        std::vector<std::string_view> sorted(json.keys.begin(), json.keys.end());
        std::sort(sorted.begin(), sorted.end());
        if (std::adjacent_find(sorted.begin(), sorted.end()) != sorted.end())
            fail("the same key twice in the object that ends");
    }

    std::size_t digits() {
        const std::size_t from = at_;
        while (at_ < text_.size() && text_[at_] >= '0' && text_[at_] <= '9') ++at_;
        return at_ - from;
    }

    double number() {
        const std::size_t from = at_;
        if (peek('-')) ++at_;
        const bool zero = peek('0');
        const std::size_t whole = digits();
        if (whole == 0 || (zero && whole > 1)) fail("not a value");
        if (peek('.')) {
            ++at_;
            if (digits() == 0) fail("not a number");
        }
        if (peek('e') || peek('E')) {
            ++at_;
            if (peek('+') || peek('-')) ++at_;
            if (digits() == 0) fail("not a number");
        }
        if (at_ - from > 400) fail("a number is too long");
        // A stream of the classic locale: strtod would follow the program's locale.
        std::istringstream stream{std::string(text_.substr(from, at_ - from))};
        stream.imbue(std::locale::classic());
        double result = 0.0;
        stream >> result;
        if (stream.fail() || !std::isfinite(result)) fail("a number is out of range");
        return result;
    }

    std::uint32_t hex4() {
        std::uint32_t code = 0;
        for (int n = 0; n < 4; ++n, ++at_) {
            const std::size_t digit = at_ < text_.size() ? std::string_view("0123456789abcdef").find(lower(text_[at_]))
                                                         : std::string_view::npos;
            if (digit == std::string_view::npos) fail("a wrong escape");
            code = code * 16 + static_cast<std::uint32_t>(digit);
        }
        return code;
    }
    static char lower(char c) { return c >= 'A' && c <= 'F' ? static_cast<char>(c - 'A' + 'a') : c; }

    static void append_utf8(std::string& out, std::uint32_t code) {
        const auto byte = [&out](std::uint32_t value) { out.push_back(static_cast<char>(value)); };
        if (code < 0x80) return byte(code);
        if (code < 0x800) return byte(0xC0 | code >> 6), byte(0x80 | (code & 0x3F));
        if (code < 0x10000) return byte(0xE0 | code >> 12), byte(0x80 | (code >> 6 & 0x3F)), byte(0x80 | (code & 0x3F));
        byte(0xF0 | code >> 18), byte(0x80 | (code >> 12 & 0x3F)), byte(0x80 | (code >> 6 & 0x3F));
        byte(0x80 | (code & 0x3F));
    }

    void escape(std::string& out) {
        ++at_;
        if (at_ >= text_.size()) fail("a string does not end");
        const char c = text_[at_++];
        const std::size_t simple = std::string_view("\"\\/bfnrt").find(c);
        if (simple != std::string_view::npos) {
            out.push_back("\"\\/\b\f\n\r\t"[simple]);
            return;
        }
        if (c != 'u') fail("a wrong escape");
        std::uint32_t code = hex4();
        if (code >= 0xD800 && code < 0xDC00 && take_word("\\u")) {
            const std::uint32_t low = hex4();
            if (low < 0xDC00 || low > 0xDFFF) fail("a wrong escape");
            code = 0x10000 + ((code - 0xD800) << 10) + (low - 0xDC00);
        }
        if (code >= 0xD800 && code <= 0xDFFF) fail("a wrong escape");
        append_utf8(out, code);
    }

    // Copies one well-formed UTF-8 character of two to four bytes (Unicode 15, table 3-7).
    void multibyte(std::string& out) {
        const auto byte = [this](std::size_t n) {
            return at_ + n < text_.size() ? static_cast<unsigned char>(text_[at_ + n]) : static_cast<unsigned char>(0);
        };
        const unsigned lead = byte(0);
        const std::size_t length = lead >= 0xC2 && lead <= 0xDF   ? 2
                                   : (lead & 0xF0) == 0xE0        ? 3
                                   : lead >= 0xF0 && lead <= 0xF4 ? 4
                                                                  : 0;
        const unsigned lowest = lead == 0xE0 ? 0xA0 : lead == 0xF0 ? 0x90 : 0x80;
        const unsigned highest = lead == 0xED ? 0x9F : lead == 0xF4 ? 0x8F : 0xBF;
        if (length == 0 || byte(1) < lowest || byte(1) > highest) fail("not UTF-8");
        for (std::size_t n = 2; n < length; ++n)
            if ((byte(n) & 0xC0) != 0x80) fail("not UTF-8");
        out.append(text_.substr(at_, length));
        at_ += length;
    }

    std::string string() {
        std::string out;
        ++at_;
        for (;;) {
            if (at_ >= text_.size()) fail("a string does not end");
            const unsigned char c = static_cast<unsigned char>(text_[at_]);
            if (c == '"') break;
            if (c < 0x20) fail("a control character");
            if (c == '\\') {
                escape(out);
            } else if (c < 0x80) {
                out.push_back(text_[at_++]);
            } else {
                multibyte(out);
            }
        }
        ++at_;
        return out;
    }

    std::string_view text_;
    const std::string& what_;
    std::size_t at_ = 0;
    std::size_t count_ = 0;
};

}  // namespace heartcase

// Converts numbers to little-endian bytes and back.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

namespace phlosar {

// Writes into a buffer. The caller makes it large enough.
class Writer {
public:
    explicit Writer(uint8_t* into) : at_(into), begin_(into) {}

    void u8(uint8_t value) { *at_++ = value; }
    void u16(uint16_t value) { unsigned_(value, 2); }
    void u32(uint32_t value) { unsigned_(value, 4); }
    void u64(uint64_t value) {
        u32(static_cast<uint32_t>(value));
        u32(static_cast<uint32_t>(value >> 32));
    }
    void f32(float value) {
        uint32_t bits;
        memcpy(&bits, &value, sizeof bits);
        u32(bits);
    }
    // Writes `size` bytes: the text, then zeros.
    void text(const char* value, size_t size) {
        for (size_t i = 0; i < size; ++i) {
            *at_++ = static_cast<uint8_t>(*value);
            if (*value != '\0') ++value;
        }
    }
    size_t size() const { return static_cast<size_t>(at_ - begin_); }

private:
    void unsigned_(uint32_t value, int size) {
        for (; size > 0; --size, value >>= 8) *at_++ = static_cast<uint8_t>(value);
    }

    uint8_t* at_;
    uint8_t* begin_;
};

// Reads from a buffer. The caller checks its size.
class Reader {
public:
    explicit Reader(const uint8_t* from) : at_(from) {}

    uint8_t u8() { return *at_++; }
    uint16_t u16() { return static_cast<uint16_t>(unsigned_(2)); }
    uint32_t u32() { return unsigned_(4); }
    uint64_t u64() {
        const uint64_t low = u32();
        return low | static_cast<uint64_t>(u32()) << 32;
    }
    float f32() {
        const uint32_t bits = u32();
        float value;
        memcpy(&value, &bits, sizeof value);
        return value;
    }

private:
    uint32_t unsigned_(unsigned size) {
        uint32_t value = 0;
        for (unsigned i = 0; i < size; ++i) value |= static_cast<uint32_t>(*at_++) << (8 * i);
        return value;
    }

    const uint8_t* at_;
};

}  // namespace phlosar

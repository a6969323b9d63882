// Bytes from the main loop to the interrupt, or back, without locks.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace phlosar {

// One side only puts, the other only takes. Either may interrupt the other.
template <size_t kSize>
class ByteRing {
public:
    // Bytes that can be put now. There may be room for more.
    size_t room() const { return kSize - 1 - used(begin_, end_); }

    // The caller checks `room` first.
    void put(const uint8_t* data, size_t size) {
        size_t at = end_;
        for (const uint8_t* stop = data + size; data != stop; ++data) {
            bytes_[at] = *data;
            at = (at + 1) & kMask;
        }
        end_ = at;
    }

    size_t take(uint8_t* into, size_t most) {
        size_t at = begin_;
        const size_t held = used(at, end_);
        const size_t count = held < most ? held : most;
        for (uint8_t* stop = into + count; into != stop; ++into) {
            *into = bytes_[at];
            at = (at + 1) & kMask;
        }
        begin_ = at;
        return count;
    }

private:
    static_assert((kSize & (kSize - 1)) == 0, "a power of two");
    static constexpr size_t kMask = kSize - 1;

    static size_t used(size_t begin, size_t end) { return (end - begin) & kMask; }

    // Volatile, so that a byte is written before its index and read after it.
    volatile uint8_t bytes_[kSize] = {};
    volatile size_t begin_ = 0;
    volatile size_t end_ = 0;
};

}  // namespace phlosar

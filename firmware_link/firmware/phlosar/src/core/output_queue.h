// Bytes for the host, until the port takes them.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace phlosar {

class OutputQueue {
public:
    size_t size() const { return size_; }

    // Appends the payload's frame. If there is no room for all of it, the frame is dropped, and the host sees a
    // missing sequence number.
    void put_frame(const uint8_t* payload, size_t size);

    size_t take(uint8_t* into, size_t most) {
        const size_t count = most < size_ ? most : size_;
        const uint8_t* at = bytes_ + begin_;
        for (uint8_t* end = into + count; into != end; ++into) {
            *into = *at++;
            if (at == bytes_ + kCapacity) at = bytes_;
        }
        begin_ = (begin_ + count) % kCapacity;
        size_ -= count;
        return count;
    }

private:
    // 32 telemetry frames. A power of two, because a Teensy LC has no division.
    static constexpr size_t kCapacity = 1024;

    uint8_t bytes_[kCapacity];
    size_t begin_ = 0;
    size_t size_ = 0;
};

}  // namespace phlosar

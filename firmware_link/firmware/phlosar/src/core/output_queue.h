// Bytes for the host, until the port takes them.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace phlosar {

class OutputQueue {
public:
    void clear() { begin_ = size_ = 0; }
    size_t size() const { return size_; }

    // All of a frame, or nothing of it: what nobody fetches is lost, frame by frame, and its number is missing.
    void put(const uint8_t* data, size_t size) {
        if (size_ + size > kCapacity) return;
        for (size_t i = 0; i < size; ++i) bytes_[(begin_ + size_ + i) % kCapacity] = data[i];
        size_ += size;
    }

    size_t take(uint8_t* into, size_t most) {
        const size_t count = most < size_ ? most : size_;
        for (size_t i = 0; i < count; ++i) into[i] = bytes_[(begin_ + i) % kCapacity];
        begin_ = (begin_ + count) % kCapacity;
        size_ -= count;
        return count;
    }

private:
    // Thirty messages of telemetry. A power of two: the chip cannot divide.
    static constexpr size_t kCapacity = 1024;

    uint8_t bytes_[kCapacity];
    size_t begin_ = 0;
    size_t size_ = 0;
};

}  // namespace phlosar

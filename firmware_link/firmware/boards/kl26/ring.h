// Bytes in order, at most a fixed number of them.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace kl26 {

// A power of two: the chip cannot divide.
template <size_t kCapacity>
class Ring {
public:
    size_t size() const { return size_; }
    size_t room() const { return kCapacity - size_; }
    void clear() { size_ = 0; }

    // As many as there is room for, and how many these are.
    size_t put(const uint8_t* data, size_t size) {
        const size_t count = size < room() ? size : room();
        for (size_t i = 0; i < count; ++i) bytes_[(begin_ + size_ + i) % kCapacity] = data[i];
        size_ += count;
        return count;
    }

    // As many as there are, up to `most`.
    size_t take(uint8_t* into, size_t most) {
        const size_t count = most < size_ ? most : size_;
        for (size_t i = 0; i < count; ++i) into[i] = bytes_[(begin_ + i) % kCapacity];
        begin_ = (begin_ + count) % kCapacity;
        size_ -= count;
        return count;
    }

private:
    static_assert((kCapacity & (kCapacity - 1)) == 0, "a power of two");

    uint8_t bytes_[kCapacity] = {};
    size_t begin_ = 0;
    size_t size_ = 0;
};

}  // namespace kl26

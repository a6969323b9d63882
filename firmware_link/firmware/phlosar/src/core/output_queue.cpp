#include "output_queue.h"

#include "framing.h"

namespace phlosar {

// Encodes straight into the ring, which saves a copy.
void OutputQueue::put_frame(const uint8_t* payload, size_t size) {
    const size_t frame_size = size + kFrameOverhead;
    if (size_ + frame_size > kCapacity) return;
    const uint16_t crc = crc16(payload, size);
    const uint8_t tail[] = {static_cast<uint8_t>(crc >> 8), static_cast<uint8_t>(crc)};
    uint8_t* const end = bytes_ + kCapacity;
    const auto next = [&](uint8_t* of) { return of + 1 == end ? bytes_ : of + 1; };
    uint8_t* code = bytes_ + (begin_ + size_) % kCapacity;
    uint8_t* at = code;
    uint8_t run = 1;
    const auto encode = [&](const uint8_t* from, const uint8_t* to) {
        for (; from != to; ++from) {
            at = next(at);
            if (*from != 0) {
                *at = *from;
                ++run;
            } else {
                *code = run;
                code = at;
                run = 1;
            }
        }
    };
    encode(payload, payload + size);
    encode(tail, tail + 2);
    *code = run;
    *next(at) = 0;
    size_ += frame_size;
}

}  // namespace phlosar

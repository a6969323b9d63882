#include "framing.h"

namespace phlosar {

namespace {

// Of each half byte: an eighth of the whole table's flash for twice the steps.
constexpr uint16_t kCrcOfNibble[16] = {
    0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7,
    0x8108, 0x9129, 0xA14A, 0xB16B, 0xC18C, 0xD1AD, 0xE1CE, 0xF1EF,
};

uint16_t crc16_nibble(uint16_t crc, unsigned nibble) {
    return static_cast<uint16_t>((crc << 4) ^ kCrcOfNibble[(crc >> 12) ^ nibble]);
}

}  // namespace

uint16_t crc16(const uint8_t* data, size_t size) {
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < size; ++i) {
        crc = crc16_nibble(crc, data[i] >> 4);
        crc = crc16_nibble(crc, data[i] & 0x0F);
    }
    return crc;
}

size_t encode_frame(const uint8_t* payload, size_t size, uint8_t* frame) {
    const uint16_t crc = crc16(payload, size);
    size_t code_at = 0;
    size_t at = 1;
    for (size_t i = 0; i < size + 2; ++i) {
        const uint8_t byte = i < size        ? payload[i]
                             : i == size ? static_cast<uint8_t>(crc >> 8)
                                         : static_cast<uint8_t>(crc);
        if (byte != 0) {
            frame[at++] = byte;
            continue;
        }
        frame[code_at] = static_cast<uint8_t>(at - code_at);
        code_at = at++;
    }
    frame[code_at] = static_cast<uint8_t>(at - code_at);
    frame[at++] = 0;
    return at;
}

bool FrameDecoder::push(uint8_t byte) {
    if (byte == 0) {
        const bool good = finish();
        held_ = 0;
        oversize_ = false;
        return good;
    }
    if (held_ == kMaxEncoded) {
        oversize_ = true;
    } else {
        buffer_[held_++] = byte;
    }
    return false;
}

bool FrameDecoder::finish() {
    if (oversize_ || held_ == 0) return false;
    // In place: what is written never overtakes what is read.
    size_t decoded = 0;
    size_t at = 0;
    while (at < held_) {
        const size_t code = buffer_[at];
        const size_t end = at + code;
        if (end > held_) return false;
        for (++at; at < end; ++at) buffer_[decoded++] = buffer_[at];
        if (at < held_) buffer_[decoded++] = 0;
    }
    if (decoded < 2 || crc16(buffer_, decoded) != 0) return false;
    size_ = decoded - 2;
    return true;
}

}  // namespace phlosar

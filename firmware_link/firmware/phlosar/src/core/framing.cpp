#include "framing.h"

namespace phlosar {

namespace {

struct CrcTable {
    constexpr CrcTable() : of_byte() {
        for (uint32_t byte = 0; byte < 256; ++byte) {
            uint32_t crc = byte << 8;
            for (int bit = 0; bit < 8; ++bit) crc = (crc << 1) ^ ((crc & 0x8000) != 0 ? 0x1021 : 0);
            of_byte[byte] = static_cast<uint16_t>(crc);
        }
    }
    uint16_t of_byte[256];
};
constexpr CrcTable kCrc;

}  // namespace

uint16_t crc16(const uint8_t* data, size_t size) {
    uint32_t crc = 0xFFFF;
    for (const uint8_t* end = data + size; data != end; ++data) {
        crc = ((crc << 8) ^ kCrc.of_byte[(crc >> 8) ^ *data]) & 0xFFFF;
    }
    return static_cast<uint16_t>(crc);
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
    // Decoded in place: writing never overtakes reading.
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

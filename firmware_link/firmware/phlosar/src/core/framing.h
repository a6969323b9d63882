// Frames on the wire: COBS( payload + CRC-16, high byte first ) + 0x00. See docs/serial-protocol.md.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace phlosar {

constexpr size_t kMaxPayload = 128;
// Payload, CRC, one byte of overhead (blocks are longer than any payload).
constexpr size_t kMaxEncoded = kMaxPayload + 2 + 1;
// CRC, overhead, and the final zero byte.
constexpr size_t kFrameOverhead = 4;

// CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF. The CRC of "123456789" is 0x29B1.
uint16_t crc16(const uint8_t* data, size_t size);

// Bytes in, payloads out. After any garbage the first frame that follows a zero byte is read.
class FrameDecoder {
public:
    // True if `byte` ends a good frame. Then `payload()` and `size()` are valid until the next byte.
    bool push(uint8_t byte);

    const uint8_t* payload() const { return buffer_; }
    size_t size() const { return size_; }

private:
    bool finish();

    uint8_t buffer_[kMaxEncoded];
    size_t held_ = 0;
    size_t size_ = 0;
    bool oversize_ = false;
};

}  // namespace phlosar

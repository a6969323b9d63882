#include "settings_memory.h"

#include "board/board.h"
#include "core/bytes.h"
#include "core/framing.h"
#include "core/settings.h"

namespace phlosar {
namespace settings_memory {

namespace {

// A copy is an image, its number, and the CRC of both. Each new copy has the next number; numbers wrap.
constexpr size_t kNumberAt = Settings::kImageSize;
constexpr size_t kCrcAt = kNumberAt + 2;
constexpr size_t kCopySize = kCrcAt + 2;
constexpr uint8_t kErased = 0xFF;
constexpr uint8_t kNone = 0xFF;

size_t address(uint8_t copy, size_t i) {
    const board::MemoryLayout& layout = board::kMemory;
    return (i / layout.share) * layout.row + copy * size_t{layout.share} + i % layout.share;
}

void read(uint8_t copy, uint8_t* into) {
    for (size_t i = 0; i < kCopySize; ++i) into[i] = board::memory_read(address(copy, i));
}

bool erased(const uint8_t* bytes) {
    for (size_t i = 0; i < kCopySize; ++i) {
        if (bytes[i] != kErased) return false;
    }
    return true;
}

struct Newest {
    uint8_t copy = kNone;
    uint16_t number = 0;
    // A copy with a wrong CRC.
    uint8_t damaged = kNone;
};

Newest find_newest() {
    Newest newest;
    uint8_t bytes[kCopySize];
    for (uint8_t copy = 0; copy < board::kMemory.copies; ++copy) {
        read(copy, bytes);
        if (erased(bytes)) continue;
        Reader tail(bytes + kNumberAt);
        const uint16_t number = tail.u16();
        if (tail.u16() != crc16(bytes, kCrcAt)) {
            newest.damaged = copy;
            continue;
        }
        const bool newer = static_cast<int16_t>(static_cast<uint16_t>(number - newest.number)) > 0;
        if (newest.copy == kNone || newer) {
            newest.copy = copy;
            newest.number = number;
        }
    }
    return newest;
}

}  // namespace

size_t load(uint8_t* image) {
    const Newest newest = find_newest();
    const uint8_t copy = newest.copy != kNone ? newest.copy : newest.damaged;
    if (copy == kNone) return 0;
    for (size_t i = 0; i < Settings::kImageSize; ++i) image[i] = board::memory_read(address(copy, i));
    return Settings::kImageSize;
}

void store(const uint8_t* image) {
    const Newest newest = find_newest();
    const bool other = newest.copy == 0 && board::kMemory.copies > 1;
    uint8_t bytes[kCopySize];
    memcpy(bytes, image, Settings::kImageSize);
    Writer tail(bytes + kNumberAt);
    tail.u16(static_cast<uint16_t>(newest.number + 1));
    tail.u16(crc16(bytes, kCrcAt));
    for (size_t i = 0; i < kCopySize; ++i) board::memory_write(address(other ? 1 : 0, i), bytes[i]);
}

}  // namespace settings_memory
}  // namespace phlosar

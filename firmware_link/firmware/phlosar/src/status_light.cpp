#include "status_light.h"

namespace phlosar {

namespace {

constexpr uint32_t kHeartbeat_ms = 2048;
constexpr uint32_t kFlash_ms = 128;
constexpr uint32_t kFlashPeriod_ms = 384;
constexpr uint32_t kPause_ms = 1280;

uint32_t flashes_of(uint16_t faults) {
    uint32_t place = 1;
    while ((faults & 1u) == 0 && place < 16) {
        faults = static_cast<uint16_t>(faults >> 1);
        ++place;
    }
    return place;
}

}  // namespace

bool light_on(Mode mode, uint16_t faults, uint32_t now_ms) {
    if (mode == Mode::kRegulate) return true;
    if (mode == Mode::kVent) return now_ms % kHeartbeat_ms < kFlash_ms;
    const uint32_t flashing_ms = flashes_of(faults) * kFlashPeriod_ms;
    const uint32_t at_ms = now_ms % (flashing_ms + kPause_ms);
    return at_ms < flashing_ms && at_ms % kFlashPeriod_ms < kFlash_ms;
}

}  // namespace phlosar

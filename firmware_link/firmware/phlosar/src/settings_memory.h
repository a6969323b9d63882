// The settings in the board's memory, in two copies where there is room: a power cut keeps the older one.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace phlosar {
namespace settings_memory {

// The newest good copy's bytes, Settings::kImageSize of them. Without a good copy what is there instead, for the
// firmware to report. 0 if nothing was ever stored.
size_t load(uint8_t* image);

// Over the older copy.
void store(const uint8_t* image);

}  // namespace settings_memory
}  // namespace phlosar

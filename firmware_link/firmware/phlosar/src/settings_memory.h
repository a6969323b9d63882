// The settings in the board's memory. If it has room for two copies, a power cut while storing damages only the
// copy that is being written.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace phlosar {
namespace settings_memory {

// Reads the newest good copy, Settings::kImageSize bytes. Without one it reads a damaged copy, so that the firmware
// reports the damage. Returns the number of bytes: 0 if nothing was ever stored.
size_t load(uint8_t* image);

// Overwrites the older copy, or the only one.
void store(const uint8_t* image);

}  // namespace settings_memory
}  // namespace phlosar

// Settings in the last two sectors of the flash, and the chip's own number.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace kl26 {

// Of the two sectors the newer complete one counts; the other is erased and written next. Power that goes
// while storing leaves the one before.
size_t load_settings(uint8_t* into, size_t most);
void store_settings(const uint8_t* data, size_t size);

// The number under which Teensy's own USB serial is known: a board keeps its name whatever is flashed.
uint32_t serial_number();

}  // namespace kl26

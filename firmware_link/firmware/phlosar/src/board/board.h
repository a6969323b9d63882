// What the firmware needs of its board, and all of it: the thin layer between the portable core and a chip.
//
// None of these waits for anybody outside the board. A board's valves are vented from its first instruction
// on, and its watchdog runs from then on: neither depends on the code above.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "../core/sensors.h"
#include "../core/valves.h"

// Told to the host as the build, with the board layer's name. At most 16 characters together.
#define PHLOSAR_VERSION "1.0"

namespace board {

extern const char kBuild[];

void begin();

// Wraps after 71 minutes.
uint32_t now_us();

phlosar::Readings read();
// Until the next call, whatever the processor does meanwhile.
void drive(const phlosar::Outputs& outputs);
void light(bool on);

// The number of bytes that were there, or that were taken: at once, and perhaps none.
size_t serial_read(uint8_t* into, size_t most);
size_t serial_write(const uint8_t* data, size_t size);

// What was stored last, or none of it; at most 128 bytes. Storing may take a tenth of a second.
size_t load(uint8_t* into, size_t most);
void store(const uint8_t* data, size_t size);

// Differs after every reset.
uint32_t boot_id();
// Or a crash that a reset ended at once.
bool reset_by_watchdog();
// Resets the board a quarter of a second after it was last fed. Nothing can stop it.
void feed_watchdog();

// A host opened the port at 134 baud: it wants to flash. The valves must be safe before `enter_bootloader`,
// which stops the processor but not its outputs.
bool bootloader_asked();
void enter_bootloader();

}  // namespace board

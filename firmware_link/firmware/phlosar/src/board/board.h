// Everything that the firmware needs of its board.
//
// No function here waits for the host. From the chip's first instructions on, before `begin`, the valves vent and a
// watchdog runs.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "../core/sensors.h"
#include "../core/valves.h"

#define PHLOSAR_VERSION "1.1"

namespace board {

// The version and the board's name, at most 16 characters. The host shows it as the build.
extern const char kBuild[];

void begin();

// Calls `step` each millisecond from a timer's interrupt.
void every_millisecond(void (*step)());

// Wraps after 71 minutes.
uint32_t now_us();

// Only the step calls these three.
phlosar::Readings read();
void drive(const phlosar::Outputs& outputs);
void light(bool on);

// Only the main loop calls these two. They do not wait, and return the number of bytes, perhaps 0. If no program
// has the port open, written bytes are lost.
size_t serial_read(uint8_t* into, size_t size);
size_t serial_write(const uint8_t* data, size_t size);

// Memory that keeps its bytes without power. Byte i of a copy is at
// (i / share) * row + copy * share + i % share: writing one copy never erases a part of another.
struct MemoryLayout {
    uint16_t row;
    uint16_t share;
    uint8_t copies;
};
extern const MemoryLayout kMemory;
uint8_t memory_read(size_t at);
// Call it only while the vine is vented: it may stop the interrupts for half a second. Feeds the watchdog.
void memory_write(size_t at, uint8_t value);

// Differs after every reset. Call it only before the first step.
uint32_t boot_id();
// Also true after a crash, which ends with a reset by the watchdog.
bool reset_by_watchdog();
// Without this call the watchdog resets the chip. Nothing can stop the watchdog.
void feed_watchdog();

// True if a host opened the port at 134 baud, to flash.
bool bootloader_requested();
// Waits for the bootloader. If it does not start, the watchdog resets the chip. The valves keep their state.
void wait_for_bootloader();

}  // namespace board

// A board of variables, for a test in Python to be everything around the firmware's loop.

#include <string.h>

#include "../../firmware_link/firmware/phlosar/src/board/board.h"
#include "../../firmware_link/firmware/phlosar/src/run.h"
#include "../../firmware_link/firmware/phlosar/src/status_light.h"

extern "C" {

struct FakeBoard {
    uint32_t now_us;
    // How long one control step takes: reading the converter moves the clock.
    uint32_t step_us;
    uint16_t readings[3];
    uint16_t evp_duty, dvp_duty;
    uint8_t solenoid, light;
    uint32_t steps, fed, stores, stored_size;
    uint8_t stored[128];
    uint8_t bootloader_asked, in_bootloader;
    uint32_t steps_at_bootloader;
    uint16_t outputs_at_bootloader[3];
    uint32_t incoming_size, outgoing_size, outgoing_room;
    uint8_t incoming[4096], outgoing[4096];
};

FakeBoard fake_board;

void run_begin() { phlosar::begin(); }
void run_turn() { phlosar::turn(); }
bool run_light(uint8_t mode, uint16_t faults, uint32_t now_ms) {
    return phlosar::light_on(static_cast<phlosar::Mode>(mode), faults, now_ms);
}

}  // extern "C"

namespace board {

extern const char kBuild[] = "fake";

void begin() {}
uint32_t now_us() { return fake_board.now_us; }

phlosar::Readings read() {
    ++fake_board.steps;
    fake_board.now_us += fake_board.step_us;
    return {fake_board.readings[0], fake_board.readings[1], fake_board.readings[2]};
}

void drive(const phlosar::Outputs& outputs) {
    fake_board.evp_duty = outputs.evp_duty;
    fake_board.dvp_duty = outputs.dvp_duty;
    fake_board.solenoid = outputs.solenoid;
}

void light(bool on) { fake_board.light = on; }

size_t serial_read(uint8_t* into, size_t most) {
    const size_t size = fake_board.incoming_size < most ? fake_board.incoming_size : most;
    memcpy(into, fake_board.incoming, size);
    memmove(fake_board.incoming, fake_board.incoming + size, fake_board.incoming_size - size);
    fake_board.incoming_size -= static_cast<uint32_t>(size);
    return size;
}

size_t serial_write(const uint8_t* data, size_t size) {
    const size_t taken = size < fake_board.outgoing_room ? size : fake_board.outgoing_room;
    memcpy(fake_board.outgoing + fake_board.outgoing_size, data, taken);
    fake_board.outgoing_size += static_cast<uint32_t>(taken);
    fake_board.outgoing_room -= static_cast<uint32_t>(taken);
    return taken;
}

size_t load(uint8_t* into, size_t most) {
    const size_t size = fake_board.stored_size < most ? fake_board.stored_size : most;
    memcpy(into, fake_board.stored, size);
    return size;
}

void store(const uint8_t* data, size_t size) {
    memcpy(fake_board.stored, data, size);
    fake_board.stored_size = static_cast<uint32_t>(size);
    ++fake_board.stores;
}

uint32_t boot_id() { return 0xB00710; }
bool reset_by_watchdog() { return false; }
void feed_watchdog() { ++fake_board.fed; }
bool bootloader_asked() { return fake_board.bootloader_asked != 0; }

void enter_bootloader() {
    fake_board.in_bootloader = 1;
    fake_board.steps_at_bootloader = fake_board.steps;
    fake_board.outputs_at_bootloader[0] = fake_board.evp_duty;
    fake_board.outputs_at_bootloader[1] = fake_board.dvp_duty;
    fake_board.outputs_at_bootloader[2] = fake_board.solenoid;
}

}  // namespace board

// A simulated board. A test in Python runs the firmware's main loop and its timer's interrupt on it.

#include <string.h>

#include "board/board.h"
#include "run.h"
#include "status_light.h"

extern "C" {

struct FakeBoard {
    uint32_t now_us;
    // Times to read the converter, to write a byte of memory (without interrupts), and to move bytes to or from
    // the port.
    uint32_t read_us, memory_us, serial_us;
    uint8_t timer_stopped;
    uint16_t readings[3];
    uint16_t evp_duty, dvp_duty;
    uint8_t solenoid, light;
    uint32_t steps, fed, memory_writes;
    uint8_t memory[1080];
    // Power fails after so many writes of memory; 0: never.
    uint32_t power_cut_after;
    uint8_t regulated_while_writing;
    uint8_t bootloader_requested, waiting_for_bootloader;
    uint32_t incoming_size, outgoing_size, outgoing_room;
    uint8_t incoming[4096], outgoing[4096];
};

FakeBoard fake_board;

}  // extern "C"

namespace {

void (*timer_step)() = nullptr;
uint32_t next_us = 0;
bool in_interrupt = false;

// The timer's interrupt: once, even if it was due several times.
void interrupt() {
    if (timer_step == nullptr || fake_board.timer_stopped != 0 || in_interrupt) return;
    if (static_cast<int32_t>(fake_board.now_us - next_us) < 0) return;
    next_us = fake_board.now_us - (fake_board.now_us - next_us) % 1000 + 1000;
    in_interrupt = true;
    timer_step();
    in_interrupt = false;
}

void pass(uint32_t us) {
    for (; us >= 50; us -= 50) {
        fake_board.now_us += 50;
        interrupt();
    }
    fake_board.now_us += us;
    interrupt();
}

}  // namespace

extern "C" {

void run_setup() { phlosar::setup(); }

void run_turn(uint32_t turn_us) {
    phlosar::loop();
    pass(turn_us);
}

// The main loop hangs.
void run_hang(uint32_t us) { pass(us); }

// The clock continues without a step.
void run_jump(uint32_t to_us) {
    fake_board.now_us = to_us;
    next_us = to_us;
}

bool run_light(uint8_t mode, uint16_t faults, uint32_t now_ms) {
    return phlosar::light_on(static_cast<phlosar::Mode>(mode), faults, now_ms);
}

}  // extern "C"

namespace board {

extern const char kBuild[] = "fake";
extern const MemoryLayout kMemory = {60, 28, FAKE_COPIES};

void begin() {}
void every_millisecond(void (*step)()) {
    timer_step = step;
    next_us = fake_board.now_us + 1000;
}
uint32_t now_us() { return fake_board.now_us; }

phlosar::Readings read() {
    ++fake_board.steps;
    fake_board.now_us += fake_board.read_us;
    return {fake_board.readings[0], fake_board.readings[1], fake_board.readings[2]};
}

void drive(const phlosar::Outputs& outputs) {
    fake_board.evp_duty = outputs.evp_duty;
    fake_board.dvp_duty = outputs.dvp_duty;
    fake_board.solenoid = outputs.solenoid;
}

void light(bool on) { fake_board.light = on; }

size_t serial_read(uint8_t* into, size_t size) {
    const size_t count = fake_board.incoming_size < size ? fake_board.incoming_size : size;
    memcpy(into, fake_board.incoming, count);
    memmove(fake_board.incoming, fake_board.incoming + count, fake_board.incoming_size - count);
    fake_board.incoming_size -= static_cast<uint32_t>(count);
    pass(fake_board.serial_us);
    return count;
}

size_t serial_write(const uint8_t* data, size_t size) {
    pass(fake_board.serial_us);
    const size_t count = size < fake_board.outgoing_room ? size : fake_board.outgoing_room;
    memcpy(fake_board.outgoing + fake_board.outgoing_size, data, count);
    fake_board.outgoing_size += static_cast<uint32_t>(count);
    fake_board.outgoing_room -= static_cast<uint32_t>(count);
    return count;
}

uint8_t memory_read(size_t at) { return fake_board.memory[at]; }

void memory_write(size_t at, uint8_t value) {
    if (fake_board.solenoid == 0 || fake_board.evp_duty != 0) fake_board.regulated_while_writing = 1;
    ++fake_board.memory_writes;
    fake_board.now_us += fake_board.memory_us;
    if (fake_board.power_cut_after == 0 || fake_board.memory_writes <= fake_board.power_cut_after) {
        fake_board.memory[at] = value;
    }
    interrupt();
}

uint32_t boot_id() { return 0xB00710; }
bool reset_by_watchdog() { return false; }
void feed_watchdog() { ++fake_board.fed; }
bool bootloader_requested() { return fake_board.bootloader_requested != 0; }

void wait_for_bootloader() {
    fake_board.waiting_for_bootloader = 1;
    pass(10000);
}

}  // namespace board

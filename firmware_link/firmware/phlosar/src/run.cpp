#include "run.h"

#include "board/board.h"
#include "byte_ring.h"
#include "core/firmware.h"
#include "settings_memory.h"
#include "status_light.h"
#include "step_monitor.h"

namespace phlosar {

namespace {

// One USB packet.
constexpr size_t kChunk = 64;
// Maximum bytes received in one step. A Teensy LC may need a whole millisecond to answer twice as many.
constexpr size_t kReceived = 32;

ByteRing<256> to_core;
ByteRing<256> to_host;
StepMonitor monitor;
uint8_t image[Settings::kImageSize];

// The main loop sets it in each turn; the step clears it.
volatile bool loop_turned = false;
// The main loop sets it, for good.
volatile bool flashing = false;
// The step sets it; the main loop clears it.
volatile bool storing = false;

Firmware& firmware() {
    static Firmware one(board::kBuild);
    return one;
}

void exchange() {
    uint8_t chunk[kChunk];
    // While the loop stores, no message may start a regulation.
    if (!storing) firmware().receive(chunk, to_core.take(chunk, kReceived));
    const size_t room = to_host.room();
    to_host.put(chunk, firmware().take_output(chunk, room < sizeof chunk ? room : sizeof chunk));
}

// Writing stops the interrupts for a while, so the vine must be vented. Writing also needs a good supply.
bool may_store() { return firmware().mode() != Mode::kRegulate && (firmware().faults() & kSupply) == 0; }

void step() {
    const uint32_t now_us = board::now_us();
    if (flashing) {
        board::drive(outputs(firmware().settings(), kSafe));
        return;
    }
    board::drive(firmware().step(now_us, board::read()));
    board::light(light_on(firmware().mode(), firmware().faults(), firmware().time_ms()));
    exchange();
    if (!storing && may_store() && firmware().unsaved(image)) storing = true;
    const bool turned = loop_turned;
    loop_turned = false;
    monitor.step(now_us, turned);
    if (monitor.healthy()) board::feed_watchdog();
}

void move_bytes() {
    static uint8_t outgoing[kChunk];
    static size_t size = 0;
    static size_t written = 0;
    uint8_t incoming[kChunk];
    const size_t room = to_core.room();
    to_core.put(incoming, board::serial_read(incoming, room < sizeof incoming ? room : sizeof incoming));
    if (written == size) {
        size = to_host.take(outgoing, sizeof outgoing);
        written = 0;
    }
    written += board::serial_write(outgoing + written, size - written);
}

}  // namespace

void setup() {
    board::begin();
    const size_t stored = settings_memory::load(image);
    firmware().start(Boot{board::boot_id(), board::reset_by_watchdog(), image, stored});
    board::every_millisecond(step);
}

void loop() {
    loop_turned = true;
    if (board::bootloader_requested()) {
        flashing = true;
        board::wait_for_bootloader();
        return;
    }
    move_bytes();
    if (storing) {
        settings_memory::store(image);
        storing = false;
    }
}

}  // namespace phlosar

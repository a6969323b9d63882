#include "run.h"

#include "board/board.h"
#include "core/firmware.h"
#include "status_light.h"
#include "step_clock.h"

namespace phlosar {

namespace {

// More at a time would keep a step waiting: of a host that asks without end, too. What is left waits in the port.
constexpr size_t kIncoming = 32;
// One USB packet.
constexpr size_t kOutgoing = 64;

uint8_t image[Settings::kImageSize];
uint8_t outgoing[kOutgoing];
size_t outgoing_size = 0;
size_t outgoing_sent = 0;
StepClock steps;

Firmware& firmware() {
    static Firmware one(board::kBuild);
    return one;
}

void converse() {
    uint8_t incoming[kIncoming];
    firmware().receive(incoming, board::serial_read(incoming, sizeof incoming));
    if (outgoing_sent == outgoing_size) {
        outgoing_size = firmware().take_output(outgoing, sizeof outgoing);
        outgoing_sent = 0;
    }
    outgoing_sent += board::serial_write(outgoing + outgoing_sent, outgoing_size - outgoing_sent);
}

}  // namespace

void begin() {
    board::begin();
    const size_t stored = board::load(image, sizeof image);
    firmware().start(Boot{board::boot_id(), board::reset_by_watchdog(), image, stored});
    steps.start(board::now_us());
}

void turn() {
    if (board::bootloader_asked()) {
        board::drive(outputs(firmware().settings(), kSafe));
        board::enter_bootloader();
        return;
    }
    converse();
    const uint32_t now_us = board::now_us();
    if (!steps.due(now_us)) return;
    board::drive(firmware().step(now_us, board::read()));
    board::light(light_on(firmware().mode(), firmware().faults(), firmware().time_ms()));
    if (!steps.steady()) return;
    board::feed_watchdog();
    // Right after the watchdog was fed, for it may take half of its time; the valves stay vented meanwhile.
    if (firmware().mode() != Mode::kRegulate && firmware().unsaved(image)) board::store(image, sizeof image);
}

}  // namespace phlosar

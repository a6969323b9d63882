// The core on an emulated processor: reads the file `inputs`, runs boards with these inputs, and writes `outputs`.
//
// tests/firmware/emulated.py writes `inputs` and reads `outputs`. All numbers are little-endian.

#include <stddef.h>
#include <stdint.h>

#include "../phlosar/src/core/bytes.h"
#include "../phlosar/src/core/firmware.h"
#include "instructions.h"
#include "semihosting.h"

using phlosar::Boot;
using phlosar::Firmware;
using phlosar::Mode;
using phlosar::Outputs;
using phlosar::Reader;
using phlosar::Readings;
using phlosar::Settings;
using phlosar::Writer;

// The calls whose instructions are counted. They are functions, so that a trace shows their names.
extern "C" {

__attribute__((noipa)) void counted_receive(Firmware* firmware, const uint8_t* data, size_t size) {
    firmware->receive(data, size);
}

__attribute__((noipa)) void counted_step(Firmware* firmware, uint32_t now_us, const Readings* readings,
                                         Outputs* told) {
    *told = firmware->step(now_us, *readings);
}

__attribute__((noipa)) size_t counted_take(Firmware* firmware, uint8_t* into, size_t size) {
    return firmware->take_output(into, size);
}

}  // extern "C"

namespace {

constexpr uint8_t kPowerUp = 'P';
constexpr uint8_t kStep = 'S';
constexpr size_t kMostBytes = 2048;
constexpr int kBadInputs = 103;

class Inputs {
public:
    // False at the end of the file. A file that ends within a record is an error.
    bool next(uint8_t* kind) { return file_.read(kind, 1) == 1; }

    Reader fields(size_t size) {
        if (size > sizeof bytes_ || file_.read(bytes_, size) != size) host::leave(kBadInputs);
        return Reader(bytes_);
    }
    const uint8_t* bytes() const { return bytes_; }

private:
    host::File file_{"inputs", host::File::Mode::kRead};
    uint8_t bytes_[kMostBytes];
};

void make_step(Firmware& firmware, Inputs& inputs, host::File& file) {
    Reader fields = inputs.fields(14);
    const uint32_t now_us = fields.u32();
    const uint16_t cv = fields.u16();
    const uint16_t reservoir = fields.u16();
    const uint16_t supply = fields.u16();
    const size_t most = fields.u16();
    const size_t size = fields.u16();
    inputs.fields(size);

    static uint8_t sent[1024];
    size_t sent_size = 0;
    Outputs told{};
    const Readings readings{cv, reservoir, supply};
    const uint32_t receive_ticks =
        instructions::ticks([&] { counted_receive(&firmware, inputs.bytes(), size); });
    const uint32_t step_ticks =
        instructions::ticks([&] { counted_step(&firmware, now_us, &readings, &told); });
    const uint32_t take_ticks = instructions::ticks(
        [&] { sent_size = counted_take(&firmware, sent, most < sizeof sent ? most : sizeof sent); });
    // A real board, too, asks for unsaved settings only while it does not regulate.
    uint8_t image[Settings::kImageSize];
    const bool unsaved = firmware.mode() != Mode::kRegulate && firmware.unsaved(image);

    uint8_t record[32];
    Writer writer(record);
    writer.u32(receive_ticks);
    writer.u32(step_ticks);
    writer.u32(take_ticks);
    writer.u16(told.evp_duty);
    writer.u16(told.dvp_duty);
    writer.u8(told.solenoid ? 1 : 0);
    writer.u8(static_cast<uint8_t>(firmware.mode()));
    writer.u16(firmware.faults());
    writer.u16(firmware.number());
    writer.u16(static_cast<uint16_t>(unsaved ? sizeof image : 0));
    writer.u16(static_cast<uint16_t>(sent_size));
    file.write(record, writer.size());
    if (unsaved) file.write(image, sizeof image);
    file.write(sent, sent_size);
}

// Runs one board until the next power-up; its own power-up was just read. True if there is another board.
bool live(Inputs& inputs, host::File& outputs) {
    Reader fields = inputs.fields(22);
    const uint32_t boot_id = fields.u32();
    const bool by_watchdog = fields.u8() != 0;
    char build[phlosar::kBuildSize + 1] = {};
    for (size_t i = 0; i < phlosar::kBuildSize; ++i) build[i] = static_cast<char>(fields.u8());
    const size_t stored_size = fields.u8();
    inputs.fields(stored_size);

    Firmware firmware(build);
    firmware.start(Boot{boot_id, by_watchdog, inputs.bytes(), stored_size});
    uint8_t kind = 0;
    while (inputs.next(&kind)) {
        if (kind == kPowerUp) return true;
        if (kind != kStep) host::leave(kBadInputs);
        make_step(firmware, inputs, outputs);
    }
    return false;
}

// A thousand instructions, with call and return.
__attribute__((naked, noinline)) void thousand() { asm volatile(".rept 998\n nop\n .endr\n bx lr"); }

// The difference of these two numbers is the ticks of a thousand instructions.
void tell_ticks(host::File& outputs) {
    uint8_t record[8];
    Writer writer(record);
    writer.u32(instructions::ticks([] { thousand(); }));
    writer.u32(instructions::ticks([] {
        thousand();
        thousand();
    }));
    outputs.write(record, writer.size());
}

}  // namespace

int main() {
    Inputs inputs;
    host::File outputs("outputs", host::File::Mode::kWrite);
    instructions::begin();
    tell_ticks(outputs);
    uint8_t kind = 0;
    if (!inputs.next(&kind) || kind != kPowerUp) return kBadInputs;
    while (live(inputs, outputs)) {
    }
    return 0;
}

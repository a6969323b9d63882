#include "flash.h"

#include <string.h>

#include "registers.h"

extern "C" const uint8_t _settings_flash[];

namespace kl26 {

namespace {

constexpr uint32_t kSector = 1024;
constexpr uint32_t kErased = 0xFFFFFFFF;
constexpr size_t kMost = 128;
// Where Teensy's number is.
constexpr uint32_t kNumberRecord = 15;

// Written last: without it a sector is not complete.
struct Header {
    uint32_t generation;
    uint32_t inverted;
};

uint32_t sector_address(unsigned sector) {
    return reinterpret_cast<uint32_t>(_settings_flash) + sector * kSector;
}

// The flash cannot be read while it works, so the waiting happens in RAM, and undisturbed.
__attribute__((section(".ram_code"), noinline)) void launch() {
    FTFA_FSTAT.write(FSTAT_CCIF);
    while (!FTFA_FSTAT.any(FSTAT_CCIF)) {}
}

void command(uint32_t code_and_address, uint32_t data) {
    const NoInterrupts alone;
    FTFA_FSTAT.write(FSTAT_ERRORS);
    FTFA_FCCOB0123.write(code_and_address);
    FTFA_FCCOB4567.write(data);
    launch();
    MCM_PLACR.set(PLACR_CFCC);
}

// 0 when the sector is not complete.
uint32_t generation(unsigned sector) {
    Header header;
    memcpy(&header, reinterpret_cast<const void*>(sector_address(sector)), sizeof header);
    return header.generation == ~header.inverted ? header.generation : 0;
}

unsigned newer_sector() { return generation(1) > generation(0) ? 1 : 0; }

}  // namespace

size_t load_settings(uint8_t* into, size_t most) {
    const unsigned sector = newer_sector();
    if (generation(sector) == 0) return 0;
    const size_t size = most < kMost ? most : kMost;
    memcpy(into, reinterpret_cast<const void*>(sector_address(sector) + sizeof(Header)), size);
    return size;
}

void store_settings(const uint8_t* data, size_t size) {
    const unsigned newer = newer_sector();
    const uint32_t generation_to_be = generation(newer) + 1;
    const uint32_t begin = sector_address(generation_to_be == 1 ? 0 : newer ^ 1u);
    command(COMMAND_ERASE_SECTOR | begin, kErased);
    for (size_t at = 0; at < size && at < kMost; at += 4) {
        uint32_t word = kErased;
        memcpy(&word, data + at, size - at < 4 ? size - at : 4);
        command(COMMAND_PROGRAM_WORD | (begin + sizeof(Header) + at), word);
    }
    command(COMMAND_PROGRAM_WORD | (begin + 4), ~generation_to_be);
    command(COMMAND_PROGRAM_WORD | begin, generation_to_be);
}

uint32_t serial_number() {
    command(COMMAND_READ_ONCE | kNumberRecord << 16, 0);
    const uint32_t number = FTFA_FCCOB4567.read();
    // A board that is none of PJRC's.
    if (number == kErased) return SIM_UIDL.read();
    // As Teensyduino does for the sake of a host's driver that needs more digits.
    return number < 10000000 ? number * 10 : number;
}

}  // namespace kl26

// From reset to the firmware, and what happens when anything goes wrong on the way.

#include <stdint.h>

#include "../../phlosar/src/run.h"
#include "pins.h"
#include "registers.h"
#include "usb.h"

extern "C" {
// From the linker script.
extern uint32_t _stack_top[];
extern const uint32_t _data_load[];
extern uint32_t _data_begin[];
extern uint32_t _data_end[];
extern uint32_t _bss_begin[];
extern uint32_t _bss_end[];

[[noreturn]] void reset_handler();
[[noreturn]] void panic_handler();
}

namespace {

using namespace kl26;

// The 16 MHz crystal, times 24, by 4 and 2: 48 MHz for the processor, 24 MHz for bus and flash. A crystal
// that does not start keeps the chip here, vented, until the watchdog resets it.
void start_clocks() {
    OSC0_CR.write(OSC_SC8P | OSC_SC2P | OSC_ERCLKEN);
    MCG_C2.write(C2_LOCRE0 | C2_RANGE_VERY_HIGH | C2_EREFS0);
    MCG_C1.write(C1_CLKS_EXTERNAL | C1_FRDIV_512);
    while (!MCG_S.any(S_OSCINIT0)) {}
    while (MCG_S.any(S_IREFST)) {}
    while ((MCG_S.read() & S_CLKST) != S_CLKST_EXTERNAL) {}
    MCG_C5.write(C5_PRDIV_4);
    MCG_C6.write(C6_PLLS | C6_VDIV_24);
    while (!MCG_S.any(S_PLLST)) {}
    while (!MCG_S.any(S_LOCK0)) {}
    SIM_CLKDIV1.write(1u << 28 | 1u << 16);
    MCG_C1.write(C1_CLKS_PLL | C1_FRDIV_512);
    while ((MCG_S.read() & S_CLKST) != S_CLKST_PLL) {}
    // From here on a crystal that stops resets the chip: without a clock the timer would hold its pins.
    MCG_C6.write(C6_PLLS | C6_CME0 | C6_VDIV_24);
    SIM_SOPT2.write(SOPT2_TPMSRC_PLL | SOPT2_USBSRC_PLL | SOPT2_PLLFLLSEL_HALF_PLL);
}

using Handler = void (*)();
constexpr unsigned kCoreVectors = 16;
constexpr unsigned kInterrupts = 32;

struct Vectors {
    uint32_t* stack_top;
    Handler handlers[kCoreVectors - 1 + kInterrupts];
};

constexpr Vectors make_vectors() {
    Vectors vectors{_stack_top, {}};
    for (Handler& handler : vectors.handlers) handler = panic_handler;
    vectors.handlers[0] = reset_handler;
    vectors.handlers[kCoreVectors - 1 + IRQ_USB] = usb_handler;
    return vectors;
}

}  // namespace

extern "C" {

extern const Vectors vectors;
__attribute__((section(".vectors"), used)) constexpr Vectors vectors = make_vectors();

// Read by the chip before the first instruction. Security and options are those that Teensyduino flashes: not
// secured, erasing by the bootloader allowed, the NMI pin off.
extern const uint8_t flash_configuration[16];
__attribute__((section(".flash_configuration"), used)) constexpr uint8_t flash_configuration[16] = {
    0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xDE, 0xF9, 0xFF, 0xFF,
};

void reset_handler() {
    // Of the chip's own 1 kHz oscillator, which needs no crystal.
    SIM_COPC.write(COPC_256_LPO_CYCLES);
    vent_valves();
    // At 2.56 V instead of 1.6 V: below it nothing here is to be believed.
    PMC_LVDSC1.write(LVDSC1_LVDRE | LVDSC1_HIGH_TRIP);

    const uint32_t* from = _data_load;
    for (uint32_t* to = _data_begin; to < _data_end;) *to++ = *from++;
    for (uint32_t* to = _bss_begin; to < _bss_end;) *to++ = 0;

    start_clocks();
    phlosar::begin();
    for (;;) phlosar::turn();
}

// Any fault of the processor, and any interrupt that nobody asked for. The reset is told as the watchdog's.
void panic_handler() {
    vent_valves();
    SIM_SRVCOP.write(0);
    for (;;) {}
}

}  // extern "C"

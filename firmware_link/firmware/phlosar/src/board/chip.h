// The functions that differ between the chips of the Teensys, for teensyduino.cpp.
#pragma once

#include <stdint.h>

#include "pins.h"

#if !defined(PHLOSAR_IDLE)
#define PHLOSAR_IDLE() __asm__ volatile("" ::: "memory")
#endif

namespace board {

// Waits until the watchdog resets the chip.
[[noreturn]] inline void wait_for_reset() {
    for (;;) PHLOSAR_IDLE();
}

namespace chip {

void begin();

// One pressure or supply reading, full scale 65535.
uint16_t convert(uint8_t pin);

// The argument of analogWrite (16 bits) for a duty cycle, full scale 65535.
int pwm_value(uint16_t duty);

// A number that differs from call to call, or after every reset.
uint32_t noise();

bool reset_by_watchdog();
void feed_watchdog();

// Between these two calls the watchdog leaves time to erase a sector of flash.
void begin_slow_work();
void end_slow_work();

// Prevents a reset by the watchdog while the bootloader flashes.
void prepare_for_bootloader();

}  // namespace chip

// The valve pins as plain outputs: EVP and DVP low, solenoid high (open). A macro, because it also runs before the
// RAM is set up, and the compiler may place a function in RAM.
#define PHLOSAR_VENT(mux)                            \
    do {                                             \
        CORE_PIN9_PORTCLEAR = CORE_PIN9_BITMASK;     \
        CORE_PIN6_PORTCLEAR = CORE_PIN6_BITMASK;     \
        CORE_PIN11_PORTSET = CORE_PIN11_BITMASK;     \
        CORE_PIN9_DDRREG |= CORE_PIN9_BITMASK;       \
        CORE_PIN6_DDRREG |= CORE_PIN6_BITMASK;       \
        CORE_PIN11_DDRREG |= CORE_PIN11_BITMASK;     \
        CORE_PIN9_CONFIG = (mux);                    \
        CORE_PIN6_CONFIG = (mux);                    \
        CORE_PIN11_CONFIG = (mux);                   \
    } while (false)

static_assert(kEvpPin == 9 && kDvpPin == 6 && kSolenoidPin == 11, "the pins of PHLOSAR_VENT");

}  // namespace board

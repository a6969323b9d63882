// What differs between the chips of the Teensys, for teensyduino.cpp.
#pragma once

#include <stdint.h>

#include "pins.h"

#if !defined(PHLOSAR_IDLE)
#define PHLOSAR_IDLE() __asm__ volatile("" ::: "memory")
#endif

namespace board {

// Until the watchdog resets the chip.
[[noreturn]] inline void wait_for_reset() {
    for (;;) PHLOSAR_IDLE();
}

namespace chip {

void begin();

// One pressure or supply reading, full scale 65535.
uint16_t convert(uint8_t pin);

// What analogWrite takes at 16 bits for a duty cycle of 65535.
int pwm_value(uint16_t duty);

// Adds bytes that differ after every reset.
uint32_t noise();

bool reset_by_watchdog();
void feed_watchdog();

// Between these two the watchdog leaves time for erasing a sector of flash.
void begin_slow_work();
void end_slow_work();

// A watchdog must not interrupt the flashing.
void prepare_for_bootloader();

}  // namespace chip

// The valve pins as plain outputs: EVP and DVP low, solenoid high (open). A macro, because it runs before the
// chip has its memory: it must not be a function that the compiler places there.
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

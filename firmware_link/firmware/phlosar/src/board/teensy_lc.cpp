// The chip of a Teensy LC, the KL26.
#if defined(__MKL26Z64__)

#include <Arduino.h>

#include "board.h"
#include "chip.h"

// Teensyduino calls this first after a reset, before any variable has its value. Its own version switches the
// watchdog off for good; this one leaves it at 1 s until `begin`, which comes after 0.3 s.
extern "C" void startup_early_hook() {
    SIM_SCGC5 |= SIM_SCGC5_PORTC | SIM_SCGC5_PORTD;
    PHLOSAR_VENT(PORT_PCR_MUX(1));
}

extern "C" void hard_fault_isr() {
    PHLOSAR_VENT(PORT_PCR_MUX(1));
    SIM_SRVCOP = 0;  // a wrong value resets the chip at once
    board::wait_for_reset();
}

namespace board {

const char kBuild[] = PHLOSAR_VERSION " teensylc";
// 128 bytes have no room for a second copy.
const MemoryLayout kMemory = {128, 128, 1};

namespace chip {

namespace {

constexpr uint32_t kCop_256_ms = 2u << 2;
constexpr unsigned kConversions = 8;  // in the converter, 17 µs together
constexpr uint8_t kTemperature = 38;
constexpr uint8_t kLockup = 0x02;

}  // namespace

void begin() {
    PHLOSAR_VENT(PORT_PCR_MUX(1));
    feed_watchdog();  // first, because the new time may count from the last feeding
    SIM_COPC = kCop_256_ms;
    analogReadResolution(16);
    analogReadAveraging(kConversions);
}

uint16_t convert(uint8_t pin) { return static_cast<uint16_t>(analogRead(pin)); }

// For Teensyduino only 65536 is fully on.
int pwm_value(uint16_t duty) { return duty + (duty >> 15); }

// Without averaging, the temperature sensor has some bits of noise.
uint32_t noise() {
    analogReadAveraging(1);
    const int reading = analogRead(kTemperature);
    analogReadAveraging(kConversions);
    return static_cast<uint32_t>(reading);
}

bool reset_by_watchdog() { return (RCM_SRS0 & RCM_SRS0_WDOG) != 0 || (RCM_SRS1 & kLockup) != 0; }

void feed_watchdog() {
    __disable_irq();
    SIM_SRVCOP = 0x55;
    SIM_SRVCOP = 0xAA;
    __enable_irq();
}

// Erasing both sectors takes less than the watchdog's time, which `begin` has set for good.
void begin_slow_work() { feed_watchdog(); }
void end_slow_work() { feed_watchdog(); }

void prepare_for_bootloader() { feed_watchdog(); }

}  // namespace chip

}  // namespace board

#endif

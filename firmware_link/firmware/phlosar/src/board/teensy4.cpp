// The chip of a Teensy 4.0 and 4.1, the i.MX RT1062.
#if defined(ARDUINO_TEENSY40) || defined(ARDUINO_TEENSY41)

#include <Arduino.h>

#include "board.h"
#include "chip.h"

extern "C" void systick_isr();

namespace {

// Times of the watchdog, (n + 1) / 2 s: 0.5 s, 2 s, 20 s.
constexpr unsigned kRunning = 0;
constexpr unsigned kSlow = 3;
constexpr unsigned kFlashing = 39;
// The multiplexer's number for plain input and output.
constexpr uint32_t kGpio = 5;

// WDE stays set until the next reset. WDBG pauses the watchdog while the bootloader's chip stops this one.
#define PHLOSAR_WATCHDOG(halves)                                                                              \
    static_cast<uint16_t>(WDOG_WCR_WT(halves) | WDOG_WCR_SRS | WDOG_WCR_WDA | WDOG_WCR_WDE | WDOG_WCR_WDBG)

// The watchdog's shortest time, 0.5 s, is too long. So SysTick vents if the watchdog is not fed for 250 ms. Then the
// step hangs or is too slow.
constexpr uint32_t kMaxUnfed_ms = 250;
volatile uint32_t unfed_ms = 0;
volatile bool guarding = false;

void set_watchdog(unsigned halves) {
    guarding = halves == kRunning;
    WDOG1_WCR = PHLOSAR_WATCHDOG(halves);
    board::chip::feed_watchdog();
}

// Replaces Teensyduino's handler, which leaves the pins as they are for 8 s.
void crash() {
    __disable_irq();
    PHLOSAR_VENT(kGpio);
    board::wait_for_reset();
}

// SysTick's interrupt, which interrupts the step.
void guard() {
    systick_isr();
    if (unfed_ms <= kMaxUnfed_ms) {
        unfed_ms = unfed_ms + 1;
    } else if (guarding) {
        crash();
    }
}

}  // namespace

// Teensyduino calls this first after a reset. No variable and no function in RAM exists yet. The fast port gets
// the valve pins here; Teensyduino would do this a little later.
extern "C" FLASHMEM void startup_early_hook() {
    IOMUXC_GPR_GPR27 = 0xFFFFFFFF;
    PHLOSAR_VENT(kGpio);
    CCM_CCGR3 |= CCM_CCGR3_WDOG1(CCM_CCGR_ON);
    WDOG1_WCR = PHLOSAR_WATCHDOG(kSlow);
}

namespace board {

#if defined(ARDUINO_TEENSY40)
const char kBuild[] = PHLOSAR_VERSION " teensy40";
// Teensyduino spreads the bytes over 15 sectors, in groups of 4. A copy has 7 sectors.
const MemoryLayout kMemory = {60, 28, 2};
#else
const char kBuild[] = PHLOSAR_VERSION " teensy41";
// The same with 63 sectors. A copy has 31.
const MemoryLayout kMemory = {252, 124, 2};
#endif

namespace chip {

namespace {

// Averaging in the converter would round to 12 bits. The sum of 16 conversions of 5 µs is a reading of 16 bits.
constexpr int kConversions = 16;
constexpr unsigned kFirstFault = 3;
constexpr unsigned kLastFault = 6;
constexpr unsigned kSysTick = 15;

bool by_watchdog = false;

}  // namespace

void begin() {
    PHLOSAR_VENT(kGpio);
    // Hard, memory, bus and usage fault.
    for (unsigned fault = kFirstFault; fault <= kLastFault; ++fault) _VectorsRam[fault] = crash;
    _VectorsRam[kSysTick] = guard;
    by_watchdog = (SRC_SRSR & SRC_SRSR_WDOG_RST_B) != 0;
    SRC_SRSR = SRC_SRSR_WDOG_RST_B;  // writing 1 clears it
    analogReadResolution(12);
    analogReadAveraging(1);
    set_watchdog(kRunning);
}

uint16_t convert(uint8_t pin) {
    int sum = 0;
    for (int i = 0; i < kConversions; ++i) sum += analogRead(pin);
    return static_cast<uint16_t>(sum);
}

// Teensyduino uses only 16 bits, so 65536 would be 0.
int pwm_value(uint16_t duty) { return duty; }

// The real-time clock continues during a reset, but not without power.
uint32_t noise() { return SNVS_LPSRTCLR ^ ARM_DWT_CYCCNT ^ HW_OCOTP_MAC0; }

bool reset_by_watchdog() { return by_watchdog; }

void feed_watchdog() {
    unfed_ms = 0;
    __disable_irq();
    WDOG1_WSR = 0x5555;
    WDOG1_WSR = 0xAAAA;
    __enable_irq();
}

// Erasing a sector takes up to 0.4 s.
void begin_slow_work() { set_watchdog(kSlow); }
void end_slow_work() { set_watchdog(kRunning); }

void prepare_for_bootloader() { set_watchdog(kFlashing); }

}  // namespace chip

}  // namespace board

#endif

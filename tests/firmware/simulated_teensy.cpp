// A simulated Teensy behind the declarations of arduino_stub. A test in Python runs the whole sketch on it.
//
// The functions do what the maker's core does on that board. Where this matters, a comment names its file.

#include <setjmp.h>
#include <string.h>

#include <Arduino.h>
#include <IntervalTimer.h>
#include <avr/eeprom.h>

extern "C" {

struct SimulatedPin {
    uint8_t level, output, pwm;
    uint16_t pwm_value;
    float pwm_Hz;
};

struct SimulatedTeensy {
    uint32_t now_us;
    SimulatedPin pins[40];
    // The converter's input, full scale 65536; the noise is added.
    uint16_t analog[40];
    uint16_t noise;
    uint32_t conversion_us;
    uint8_t was_reset;
    uint32_t watchdog_us, fed_us, feeds;
    uint8_t watchdog_on;
    uint8_t memory[1080];
    uint32_t memory_writes, memory_us;
    uint32_t timer_us;
    uint8_t priority, step_hangs;
    uint32_t systicks;
    // True if EVP and DVP were off 5 ms after the firmware began to wait for a bootloader or a reset.
    uint32_t idles;
    uint8_t off_while_idle;
    uint8_t dtr, usb_stalled;
    uint32_t baud;
    uint32_t waited_for_host_us;
    uint32_t incoming_size, outgoing_size, in_flight, unsent;
    uint8_t incoming[4096], outgoing[65536];
    // The operations on the valve pins, in order: 'c' cleared, 's' set, 'o' output, 'm' multiplexer.
    char order[64];
};

SimulatedTeensy sim;

}  // extern "C"

namespace {

jmp_buf reset_point;
void (*timer_function)() = nullptr;
uint32_t next_us = 0;
bool interrupts = true;
bool in_interrupt = false;
unsigned resolution = 10;
unsigned write_resolution = 8;
uint32_t random_state = 1;

void reset() {
    sim.was_reset = 1;
    longjmp(reset_point, 1);
}

void interrupt() {
    if (timer_function == nullptr || in_interrupt || !interrupts || sim.step_hangs != 0) return;
    if (static_cast<int32_t>(sim.now_us - next_us) < 0) return;
    next_us += (sim.now_us - next_us) / sim.timer_us * sim.timer_us + sim.timer_us;
    in_interrupt = true;
    timer_function();
    in_interrupt = false;
}

// Its priority is higher than that of the step.
void systick() {
#if defined(__MKL26Z64__)
    systick_isr();
#else
    (_VectorsRam[15] != nullptr ? _VectorsRam[15] : systick_isr)();
#endif
}

void pass(uint32_t us) {
    while (us > 0) {
        const uint32_t part = us < 50 ? us : 50;
        const bool tick = (sim.now_us + part) / 1000 != sim.now_us / 1000;
        sim.now_us += part;
        us -= part;
        if (tick && interrupts) systick();
        if (sim.watchdog_on != 0 && sim.now_us - sim.fed_us >= sim.watchdog_us) reset();
        interrupt();
    }
}

void feed() {
    sim.fed_us = sim.now_us;
    ++sim.feeds;
}

void note(char what) {
    const size_t size = strlen(sim.order);
    if (size + 1 < sizeof sim.order) sim.order[size] = what;
}

}  // namespace

#define SIM_PIN_REGISTERS(n)                            \
    Register CORE_PIN##n##_PORTCLEAR{Kind::kPortClear, n, 0}; \
    Register CORE_PIN##n##_PORTSET{Kind::kPortSet, n, 0};     \
    Register CORE_PIN##n##_DDRREG{Kind::kDirection, n, 0};    \
    Register CORE_PIN##n##_CONFIG{Kind::kConfig, n, 0}
SIM_PIN_REGISTERS(6);
SIM_PIN_REGISTERS(9);
SIM_PIN_REGISTERS(11);

#if defined(__MKL26Z64__)
constexpr uint32_t kGpio = PORT_PCR_MUX(1);
Register SIM_SCGC5{Kind::kPlain, 0, 0}, SIM_COPC{Kind::kWatchdog, 0, 0x0C}, SIM_SRVCOP{Kind::kFeed, 0, 0};
Register RCM_SRS0{Kind::kPlain, 0, 0}, RCM_SRS1{Kind::kPlain, 0, 0};
#else
constexpr uint32_t kGpio = 5;
Register IOMUXC_GPR_GPR27{Kind::kPlain, 0, 0}, CCM_CCGR3{Kind::kPlain, 0, 0}, WDOG1_WCR{Kind::kWatchdog, 0, 0x30};
Register WDOG1_WSR{Kind::kFeed, 0, 0}, SRC_SRSR{Kind::kResetCause, 0, 1};
Register SNVS_LPSRTCLR{Kind::kPlain, 0, 0}, ARM_DWT_CYCCNT{Kind::kPlain, 0, 0}, HW_OCOTP_MAC0{Kind::kPlain, 0, 0};
void (*volatile _VectorsRam[176])(void);
#endif

Register& Register::operator=(uint32_t written) {
    const uint32_t before = value;
    value = written;
    switch (kind) {
        case Kind::kPlain:
            break;
        case Kind::kPortClear:
            sim.pins[pin].level = 0;
            note('c');
            break;
        case Kind::kPortSet:
            sim.pins[pin].level = 1;
            note('s');
            break;
        case Kind::kDirection:
            sim.pins[pin].output = (written >> pin & 1) != 0;
            note('o');
            break;
        case Kind::kConfig:
            sim.pins[pin].pwm = written != kGpio;
            note('m');
            break;
#if defined(__MKL26Z64__)
        case Kind::kWatchdog:  // KL26: written once after a reset; 0 is off
            sim.watchdog_on = (written & 0x0C) != 0;
            sim.watchdog_us = written == 0x0C ? 1024000 : written == 0x08 ? 256000 : 32000;
            break;
        case Kind::kFeed:
            if (written == 0xAA && before == 0x55) {
                feed();
            } else if (written != 0x55) {
                reset();
            }
            break;
        case Kind::kResetCause:
            break;
#else
        case Kind::kWatchdog:  // i.MX RT1060: WDE cannot be cleared; a new time counts from the next feeding
            value = written | (before & WDOG_WCR_WDE);
            if ((CCM_CCGR3 & CCM_CCGR3_WDOG1(CCM_CCGR_ON)) == 0) value = before;
            if ((before & WDOG_WCR_WDE) == 0 && (value & WDOG_WCR_WDE) != 0) {
                sim.watchdog_on = 1;
                sim.watchdog_us = 500000 * ((value >> 8) + 1);
                feed();
            }
            break;
        case Kind::kFeed:
            if (written == 0xAAAA && before == 0x5555) {
                sim.watchdog_us = 500000 * ((WDOG1_WCR.value >> 8) + 1);
                feed();
            }
            break;
        case Kind::kResetCause:
            value = before & ~written;
            break;
#endif
    }
    return *this;
}

void sim_interrupts(bool on) {
    interrupts = on;
    interrupt();
}

void sim_idle() {
    pass(50);
    if (++sim.idles != 100) return;
    const SimulatedPin& dvp = sim.pins[6];
    const SimulatedPin& evp = sim.pins[9];
    sim.off_while_idle = evp.pwm == 0 && evp.level == 0 && dvp.pwm == 0 && dvp.level == 0;
}

void pinMode(uint8_t pin, uint8_t mode) {
    sim.pins[pin].output = mode == OUTPUT;
    sim.pins[pin].pwm = 0;
}

void digitalWrite(uint8_t pin, uint8_t value) { sim.pins[pin].level = value; }

// Each conversion waits in `yield`, and interrupts an earlier one only on a Teensy LC (analog.c).
int analogRead(uint8_t pin) {
    yield();
    pass(in_interrupt ? 0 : sim.conversion_us);
    if (in_interrupt) sim.now_us += sim.conversion_us;
    random_state = random_state * 1664525u + 1013904223u;
    const uint32_t seen = sim.analog[pin] + (sim.noise != 0 ? random_state >> 8 & sim.noise : 0u);
    return static_cast<int>((seen < 65535 ? seen : 65535) >> (16 - resolution));
}

void analogReadRes(unsigned int bits) {
#if defined(__MKL26Z64__)
    resolution = bits;
#else
    resolution = bits <= 8 ? 8 : bits == 10 ? 10 : 12;  // analog.c of teensy4
#endif
}

void analogReadAveraging(unsigned int) {}

uint32_t analogWriteRes(uint32_t bits) {
    write_resolution = bits;
    return bits;
}

void analogWriteFrequency(uint8_t pin, float frequency) { sim.pins[pin].pwm_Hz = frequency; }

void analogWrite(uint8_t pin, int value) {
    SimulatedPin& one = sim.pins[pin];
#if defined(__MKL26Z64__)
    if (value <= 0 || value >= 1 << write_resolution) {  // pins_teensy.c
        one.level = value > 0;
        one.output = 1;
        one.pwm = 0;
        return;
    }
    one.pwm_value = static_cast<uint16_t>(value);
#else
    one.pwm_value = static_cast<uint16_t>(value);  // pwm.c keeps 16 bits
#endif
    one.pwm = 1;
}

extern "C" void systick_isr() { ++sim.systicks; }

uint32_t micros() { return sim.now_us; }
uint32_t millis() { return sim.now_us / 1000; }

void IntervalTimer::priority(uint8_t level) { sim.priority = level; }

bool IntervalTimer::begin(void (*function)(), unsigned period_us) {
    timer_function = function;
    sim.timer_us = period_us;
    next_us = sim.now_us + period_us;
    return true;
}

extern "C" uint8_t eeprom_read_byte(const uint8_t* address) {
    const size_t at = reinterpret_cast<size_t>(address);
#if defined(__MKL26Z64__)
    return at < 128 ? sim.memory[at] : 0xFF;
#else
    return at < sizeof sim.memory ? sim.memory[at] : 0xFF;
#endif
}

// Without interrupts for as long as erasing takes.
extern "C" void eeprom_write_byte(uint8_t* address, uint8_t value) {
    const size_t at = reinterpret_cast<size_t>(address);
    interrupts = false;
    pass(sim.memory_us);
    ++sim.memory_writes;
    if (at < sizeof sim.memory) sim.memory[at] = value;
    interrupts = true;
    interrupt();
}

usb_serial_class Serial;

int usb_serial_class::available() { return static_cast<int>(sim.incoming_size); }

size_t usb_serial_class::readBytes(char* buffer, size_t length) {
    const size_t count = sim.incoming_size < length ? sim.incoming_size : length;
    if (count < length) pass(1000000);  // waits for the rest, up to its timeout
    memcpy(buffer, sim.incoming, count);
    memmove(sim.incoming, sim.incoming + count, sim.incoming_size - count);
    sim.incoming_size -= static_cast<uint32_t>(count);
    return count;
}

#if defined(__MKL26Z64__)
constexpr uint32_t kRoom = 64;
constexpr uint32_t kBuffers = 8;
#else
constexpr uint32_t kRoom = 2048;
constexpr uint32_t kBuffers = 4;
#endif

// teensy4 reports the empty buffers but not the one that is being filled; teensy3 reports the rest of that one.
int usb_serial_class::availableForWrite() {
    if (sim.in_flight >= kBuffers - 1) return 0;
#if defined(__MKL26Z64__)
    return static_cast<int>(kRoom - sim.unsent);
#else
    return static_cast<int>(kRoom * (kBuffers - 1 - sim.in_flight));
#endif
}

size_t usb_serial_class::write(const uint8_t* buffer, size_t size) {
    if (size > static_cast<size_t>(availableForWrite())) {
        sim.waited_for_host_us += 120000;
        pass(120000);
        return 0;
    }
    if (sim.outgoing_size + size > sizeof sim.outgoing) sim.outgoing_size = 0;  // no test reads it
    memcpy(sim.outgoing + sim.outgoing_size, buffer, size);
    sim.outgoing_size += static_cast<uint32_t>(size);
    sim.unsent += static_cast<uint32_t>(size);
    return size;
}

void usb_serial_class::send_now() {
    if (sim.unsent > 0 && sim.usb_stalled != 0) ++sim.in_flight;
    sim.unsent = 0;
}

uint32_t usb_serial_class::baud() { return sim.baud; }
uint8_t usb_serial_class::dtr() { return sim.dtr; }

extern "C" {

// Each returns true if the chip was reset meanwhile.
bool sim_early_hook() {
    if (setjmp(reset_point) != 0) return true;
#if defined(__MKL26Z64__)
    sim.watchdog_on = 1;
    sim.watchdog_us = 1024000;
#endif
    startup_early_hook();
    pass(300000);  // the start of the maker's core
    return false;
}

bool sim_setup() {
    if (setjmp(reset_point) != 0) return true;
    setup();
    return false;
}

bool sim_run(uint32_t us) {
    if (setjmp(reset_point) != 0) return true;
    for (const uint32_t begin_us = sim.now_us; sim.now_us - begin_us < us;) {
        loop();
        pass(50);
    }
    return false;
}

// The main loop hangs, or the whole processor.
bool sim_hang(uint32_t us, bool with_interrupts) {
    if (setjmp(reset_point) != 0) return true;
    interrupts = with_interrupts;
    pass(us);
    interrupts = true;
    return false;
}

// A fault of the processor: a wrong address, for example.
bool sim_crash() {
    if (setjmp(reset_point) != 0) return true;
#if defined(__MKL26Z64__)
    extern void hard_fault_isr();
    hard_fault_isr();
#else
    if (_VectorsRam[3] != nullptr) _VectorsRam[3]();
#endif
    return false;
}

void sim_reset_cause_watchdog() {
#if defined(__MKL26Z64__)
    RCM_SRS0.value = RCM_SRS0_WDOG;
#else
    SRC_SRSR.value |= SRC_SRSR_WDOG_RST_B;
#endif
}

}  // extern "C"

// The board layer on Teensyduino's functions, for all Teensys that the firmware knows.
#if defined(ARDUINO)

#if !defined(ARDUINO_TEENSY40) && !defined(ARDUINO_TEENSY41) && !defined(__MKL26Z64__)
#error "phlosar supports Teensy 4.0, Teensy 4.1 and Teensy LC: choose one of them under Tools, Board"
#endif

#include <Arduino.h>
#include <IntervalTimer.h>
#include <avr/eeprom.h>
#include <new>

#include "board.h"
#include "chip.h"

// analogRead calls this while it waits, here from an interrupt. Teensyduino's `yield` would read the serial port.
extern "C" void yield() {}

namespace board {

namespace {

// A lower priority than SysTick, which counts the milliseconds; not lower than USB.
constexpr uint8_t kStepPriority = 64;
constexpr unsigned kStep_us = 1000;
constexpr uint32_t kBootloaderBaud = 134;
constexpr uint32_t kBootloaderWait_ms = 1000;

// A closed valve is a plain low output, which does not depend on the timer.
void open_valve(uint8_t pin, uint16_t duty) {
    if (duty > 0) {
        analogWrite(pin, chip::pwm_value(duty));
    } else {
        digitalWrite(pin, LOW);
        pinMode(pin, OUTPUT);
    }
}

uint8_t* memory_address(size_t at) { return reinterpret_cast<uint8_t*>(at); }

}  // namespace

void begin() {
    chip::begin();
    pinMode(kLightPin, OUTPUT);
    // INPUT_DISABLE: without the pins' keepers, which would hold the voltage of an open wire.
    pinMode(kCvPin, INPUT_DISABLE);
    pinMode(kReservoirPin, INPUT_DISABLE);
    pinMode(kSupplyPin, INPUT_DISABLE);
    analogWriteResolution(16);
    analogWriteFrequency(kEvpPin, kPwm_Hz);
    analogWriteFrequency(kDvpPin, kPwm_Hz);
}

// The timer is never destroyed, because the destructor of a static variable needs the heap.
void every_millisecond(void (*step)()) {
    alignas(IntervalTimer) static uint8_t memory[sizeof(IntervalTimer)];
    IntervalTimer* const timer = new (memory) IntervalTimer;
    timer->priority(kStepPriority);
    timer->begin(step, kStep_us);
}

uint32_t now_us() { return micros(); }

phlosar::Readings read() {
    phlosar::Readings readings;
    readings.cv = chip::convert(kCvPin);
    readings.reservoir = chip::convert(kReservoirPin);
    readings.supply = chip::convert(kSupplyPin);
    return readings;
}

void drive(const phlosar::Outputs& outputs) {
    open_valve(kEvpPin, outputs.evp_duty);
    open_valve(kDvpPin, outputs.dvp_duty);
    digitalWrite(kSolenoidPin, outputs.solenoid ? HIGH : LOW);
}

void light(bool on) { digitalWrite(kLightPin, on ? HIGH : LOW); }

size_t serial_read(uint8_t* into, size_t size) {
    const int available = Serial.available();
    if (available <= 0) return 0;
    const size_t count = static_cast<size_t>(available) < size ? static_cast<size_t>(available) : size;
    return Serial.readBytes(reinterpret_cast<char*>(into), count);
}

// Writes only what Teensyduino has room for. More would wait for the host, up to 0.12 s. Sends at once, because a
// Teensy LC may not have the reported room later.
size_t serial_write(const uint8_t* data, size_t size) {
    if (!Serial.dtr()) return size;
    const int room = Serial.availableForWrite();
    if (room <= 0 || size == 0) return 0;
    const size_t count = static_cast<size_t>(room) < size ? static_cast<size_t>(room) : size;
    const size_t written = Serial.write(data, count);
    Serial.send_now();
    return written <= count ? written : 0;  // a Teensy LC's failure is -1
}

uint8_t memory_read(size_t at) { return eeprom_read_byte(memory_address(at)); }

// Equal bytes are not written, because a Teensy LC may erase its flash for each write.
void memory_write(size_t at, uint8_t value) {
    if (memory_read(at) == value) return;
    chip::begin_slow_work();
    eeprom_write_byte(memory_address(at), value);
    chip::end_slow_work();
}

uint32_t boot_id() {
    uint32_t hash = 2166136261u;
    for (int i = 0; i < 64; ++i) {
        hash = (hash ^ chip::noise()) * 16777619u;
        hash = (hash ^ static_cast<uint32_t>(analogRead(kSupplyPin))) * 16777619u;
    }
    return hash;
}

bool reset_by_watchdog() { return chip::reset_by_watchdog(); }
void feed_watchdog() { chip::feed_watchdog(); }

bool bootloader_requested() { return Serial.baud() == kBootloaderBaud; }

// Teensyduino starts the bootloader by itself, some milliseconds after the host's request.
void wait_for_bootloader() {
    chip::prepare_for_bootloader();
    const uint32_t begin_ms = millis();
    while (millis() - begin_ms < kBootloaderWait_ms) PHLOSAR_IDLE();
    chip::end_slow_work();
    wait_for_reset();
}

}  // namespace board

#endif

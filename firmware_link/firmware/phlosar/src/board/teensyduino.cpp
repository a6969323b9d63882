// The board layer by Teensyduino, for the Arduino IDE and PlatformIO.
#if defined(ARDUINO)

#include "board.h"

#include <Arduino.h>
#include <avr/eeprom.h>

#include "pins.h"

#if !defined(__MKL26Z64__)
#error "This firmware is for a Teensy LC: choose it as the board"
#endif

// Teensyduino calls this first thing after a reset, before any variable has its value. Its own switches the
// watchdog off, for good; this one leaves it at a second until `begin`, which is reached after 0.3 s.
extern "C" void startup_early_hook() {
    SIM_SCGC5 |= SIM_SCGC5_PORTC;
    GPIOC_PCOR = CORE_PIN9_BITMASK | CORE_PIN10_BITMASK;
    GPIOC_PSOR = CORE_PIN11_BITMASK;
    GPIOC_PDDR |= CORE_PIN9_BITMASK | CORE_PIN10_BITMASK | CORE_PIN11_BITMASK;
    CORE_PIN9_CONFIG = PORT_PCR_MUX(1);
    CORE_PIN10_CONFIG = PORT_PCR_MUX(1);
    CORE_PIN11_CONFIG = PORT_PCR_MUX(1);
}

// Anything but the feeding of the watchdog resets the chip at once.
extern "C" void hard_fault_isr() {
    startup_early_hook();
    SIM_SRVCOP = 0;
    for (;;) {}
}

namespace board {

namespace {

static_assert(kEvpPin == 9 && kDvpPin == 10 && kSolenoidPin == 11, "the pins of startup_early_hook");

constexpr uint32_t kCop_256_ms = 2u << 2;
constexpr uint8_t kTemperature = 38;
constexpr uint32_t kBootloaderBaud = 134;
constexpr uint8_t kErased = 0xFF;

// Of 65536, for Teensyduino calls all on what is beyond the largest number of 16 bits.
int full_scale(uint16_t duty) { return duty + (duty >> 15); }

uint8_t* eeprom_address(size_t at) { return reinterpret_cast<uint8_t*>(at); }

}  // namespace

extern const char kBuild[] = PHLOSAR_VERSION " teensyduino";

void begin() {
    SIM_COPC = kCop_256_ms;
    pinMode(kSolenoidPin, OUTPUT);
    pinMode(kLightPin, OUTPUT);
    analogWriteResolution(16);
    analogWriteFrequency(kEvpPin, kPwm_Hz);
    analogWriteFrequency(kDvpPin, kPwm_Hz);
    analogReadResolution(16);
    analogReadAveraging(kConversions);
}

uint32_t now_us() { return micros(); }

phlosar::Readings read() {
    phlosar::Readings readings;
    readings.cv = static_cast<uint16_t>(analogRead(kCvPin));
    readings.reservoir = static_cast<uint16_t>(analogRead(kReservoirPin));
    readings.supply = static_cast<uint16_t>(analogRead(kSupplyPin));
    return readings;
}

void drive(const phlosar::Outputs& outputs) {
    analogWrite(kEvpPin, full_scale(outputs.evp_duty));
    analogWrite(kDvpPin, full_scale(outputs.dvp_duty));
    digitalWrite(kSolenoidPin, outputs.solenoid ? HIGH : LOW);
}

void light(bool on) { digitalWrite(kLightPin, on ? HIGH : LOW); }

size_t serial_read(uint8_t* into, size_t most) {
    const int there = Serial.available();
    if (there <= 0) return 0;
    const size_t size = static_cast<size_t>(there) < most ? static_cast<size_t>(there) : most;
    return Serial.readBytes(reinterpret_cast<char*>(into), size);
}

// While no program holds the port open, nothing is kept for the next one. What is written is sent at once:
// only then is the room that Teensyduino promises still there when it is used, and writing never waits.
size_t serial_write(const uint8_t* data, size_t size) {
    if (!Serial.dtr()) return size;
    const int room = Serial.availableForWrite();
    if (room <= 0 || size == 0) return 0;
    const size_t count = static_cast<size_t>(room) < size ? static_cast<size_t>(room) : size;
    const size_t taken = Serial.write(data, count);
    Serial.send_now();
    return taken;
}

size_t load(uint8_t* into, size_t most) {
    bool erased = true;
    for (size_t i = 0; i < most; ++i) {
        into[i] = eeprom_read_byte(eeprom_address(i));
        if (into[i] != kErased) erased = false;
    }
    return erased ? 0 : most;
}

// Byte by byte, for each may cost an erasing of both sectors: what did not change is not written.
void store(const uint8_t* data, size_t size) {
    for (size_t i = 0; i < size; ++i) {
        if (eeprom_read_byte(eeprom_address(i)) != data[i]) eeprom_write_byte(eeprom_address(i), data[i]);
        feed_watchdog();
    }
}

// The converter's noise, from the temperature sensor one conversion at a time: some bits in each of 64.
uint32_t boot_id() {
    analogReadAveraging(1);
    uint32_t hash = 2166136261u;
    for (int i = 0; i < 64; ++i) hash = (hash ^ static_cast<uint32_t>(analogRead(kTemperature))) * 16777619u;
    analogReadAveraging(kConversions);
    return hash;
}

bool reset_by_watchdog() { return (RCM_SRS0 & RCM_SRS0_WDOG) != 0 || (RCM_SRS1 & 0x02) != 0; }

void feed_watchdog() {
    __disable_irq();
    SIM_SRVCOP = 0x55;
    SIM_SRVCOP = 0xAA;
    __enable_irq();
}

bool bootloader_asked() { return Serial.baud() == kBootloaderBaud; }

// Teensyduino enters it by itself, 15 ms after the host asked; where that fails, the watchdog ends the wait.
void enter_bootloader() {
    for (;;) {}
}

}  // namespace board

#endif

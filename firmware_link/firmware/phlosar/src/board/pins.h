// Which pin of a Teensy LC is what, for both board layers. With a drawing: docs/wiring.md.
#pragma once

#include <stdint.h>

namespace board {

// Port C, bits 3, 4, 6 and 5. The first two are channels 2 and 3 of the timer TPM0.
constexpr uint8_t kEvpPin = 9;
constexpr uint8_t kDvpPin = 10;
constexpr uint8_t kSolenoidPin = 11;
constexpr uint8_t kLightPin = 13;

// Converter channels 12, 13 and 14, which need no choice between two pins.
constexpr uint8_t kCvPin = 19;
constexpr uint8_t kReservoirPin = 18;
constexpr uint8_t kSupplyPin = 15;

// Beyond hearing, and below the 25 kHz at which an L298N still switches cleanly.
constexpr uint32_t kPwm_Hz = 20000;
// Of hardware averaging: 17 µs a channel.
constexpr uint8_t kConversions = 8;

}  // namespace board

// The pins are the same on every board. A drawing is in docs/wiring.md.
#pragma once

#include <stdint.h>

namespace board {

// The two PWM pins share one timer: TPM0 channels 2 and 4 on a Teensy LC, FlexPWM2 submodule 2 on a Teensy 4.
constexpr uint8_t kEvpPin = 9;
constexpr uint8_t kDvpPin = 6;
constexpr uint8_t kSolenoidPin = 11;
constexpr uint8_t kLightPin = 13;

// A5, A4 and A1: one converter has all three.
constexpr uint8_t kCvPin = 19;
constexpr uint8_t kReservoirPin = 18;
constexpr uint8_t kSupplyPin = 15;

// Inaudible, and below the 25 kHz up to which an L298N switches cleanly.
constexpr float kPwm_Hz = 20000.0f;

}  // namespace board

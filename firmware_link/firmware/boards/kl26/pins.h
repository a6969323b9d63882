// The valves' pins on port C, and the state that they are put into without anything else working.
#pragma once

#include "registers.h"

namespace kl26 {

constexpr unsigned kEvpBit = 3;
constexpr unsigned kDvpBit = 4;
constexpr unsigned kSolenoidBit = 6;
constexpr unsigned kLightBit = 5;
constexpr unsigned kEvpChannel = 2;
constexpr unsigned kDvpChannel = 3;

// Inflation valve and Venturi off, solenoid open. Needs no memory, no timer, no clock but that after a reset.
inline void vent_valves() {
    SIM_SCGC5.set(SCGC5_PORTC);
    GPIOC_PCOR.write(1u << kEvpBit | 1u << kDvpBit);
    GPIOC_PSOR.write(1u << kSolenoidBit);
    GPIOC_PDDR.set(1u << kEvpBit | 1u << kDvpBit | 1u << kSolenoidBit | 1u << kLightBit);
    portc_pcr(kEvpBit).write(PCR_MUX_GPIO);
    portc_pcr(kDvpBit).write(PCR_MUX_GPIO);
    portc_pcr(kSolenoidBit).write(PCR_MUX_GPIO);
    portc_pcr(kLightBit).write(PCR_MUX_GPIO);
}

}  // namespace kl26

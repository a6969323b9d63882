// From openings to the duty cycles of the valves' drivers.
#pragma once

#include <stdint.h>

#include "real.h"
#include "settings.h"

namespace phlosar {

// Commands to the valves. An opening is the fraction 0…1 of a valve's full current.
struct Drive {
    Real evp;
    Real dvp;
    bool solenoid;
};

// Inflation valve closed, Venturi off, solenoid open.
constexpr Drive kSafe{Real(0), Real(0), true};

// Duty cycles, full scale 65535.
struct Outputs {
    uint16_t evp_duty;
    uint16_t dvp_duty;
    bool solenoid;
};

// Duty cycle of an opening, full scale 65535.
inline uint16_t duty(Real opening, Real full_duty) {
    if (!(opening > Real(0))) return 0;
    const Real share = smaller(Real(1), opening) * full_duty;
    return static_cast<uint16_t>(static_cast<int32_t>(share * Real(65535) + Real(0.5)));
}

// The regulator's openings, raised above the dead bands. A valve does not open in its dead band.
Drive over_dead_bands(const Settings& settings, const Drive& wanted);

// A valve's current is proportional to the driver's duty cycle.
Outputs outputs(const Settings& settings, const Drive& told);

}  // namespace phlosar

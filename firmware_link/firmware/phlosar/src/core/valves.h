// From openings to the duty cycles of the valves' drivers.
#pragma once

#include <stdint.h>

#include "real.h"
#include "settings.h"

namespace phlosar {

// What the valves are told. An opening is the fraction 0…1 of a valve's full current.
struct Drive {
    Real evp;
    Real dvp;
    bool solenoid;
};

// Nothing goes in, everything may leave, and no air is spent on it.
constexpr Drive kSafe{Real(0), Real(0), true};

// Duty cycles of 65535.
struct Outputs {
    uint16_t evp_duty;
    uint16_t dvp_duty;
    bool solenoid;
};

// Of 65535; with a full duty of 1 the opening itself.
inline uint16_t duty(Real opening, Real full_duty) {
    if (!(opening > Real(0))) return 0;
    const Real share = smaller(Real(1), opening) * full_duty;
    return static_cast<uint16_t>(static_cast<int32_t>(share * Real(65535) + Real(0.5)));
}

// What the regulator wants, lifted over the currents at which the valves do not open yet.
Drive over_dead_bands(const Settings& settings, const Drive& wanted);

// A valve's flow is affine in its current, and its current is what the driver's duty makes of the supply.
Outputs outputs(const Settings& settings, const Drive& told);

}  // namespace phlosar

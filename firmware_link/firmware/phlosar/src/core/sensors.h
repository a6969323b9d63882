// From the converter's counts to pressures.
#pragma once

#include <stdint.h>

#include "real.h"
#include "settings.h"

namespace phlosar {

// The converter's three channels, full scale 65535. Each comes through the same divider, so the sensors'
// share of their own supply is a ratio of counts, whatever the converter's reference is.
struct Readings {
    uint16_t cv;
    uint16_t reservoir;
    uint16_t supply;
};

// Gauge. A pressure that cannot be believed is NaN.
struct Pressures {
    Real cv_kPa;
    Real reservoir_kPa;
    bool supply_good;
};

// 5 V through a divider of 0.6 into a converter of 3.3 V; 10 % less is too little for the sensors, and at
// full scale it is not known how much more it is.
constexpr uint16_t kSupplyLeast = 53621;
constexpr uint16_t kSupplyMost = 65500;

// A sensor as it is set, ready for the step: what can be computed beforehand is.
struct Sensor {
    // Whether the sensor can say so: it ends at 2.5 and 97.5 % of its supply, so what is below 1.5 or above
    // 98.5 % is its wiring. False for NaN.
    bool can_say(Real kPa) const { return kPa >= least_kPa && kPa <= most_kPa; }

    // Of the sensor's whole supply.
    Real per_share_kPa;
    Real zero_kPa;
    Real least_kPa;
    Real most_kPa;
};

Sensor sensor(Real span_kPa, Real zero_kPa);

Pressures pressures(const Sensor& cv, const Sensor& reservoir, const Readings& readings);

}  // namespace phlosar

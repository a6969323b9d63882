// From the converter's counts to pressures.
#pragma once

#include <stdint.h>

#include "real.h"
#include "settings.h"

namespace phlosar {

// Counts of the converter's three channels, full scale 65535. All have the same divider, so a sensor's voltage
// divided by its supply voltage is a ratio of counts. The converter's reference does not matter.
struct Readings {
    uint16_t cv;
    uint16_t reservoir;
    uint16_t supply;
};

// Gauge. NaN if the sensors' supply is out of range.
struct Pressures {
    Real cv_kPa;
    Real reservoir_kPa;
    bool supply_good;
};

// Counts of the sensors' 5 V: 59578, through a divider of 0.6 into a converter of 3.3 V. The sensors need at
// least 90 % of this. Near full scale the converter cannot measure the voltage.
constexpr uint16_t kSupplyLeast = 53621;
constexpr uint16_t kSupplyMost = 65500;

// A sensor's calibration, computed once from its settings.
struct Sensor {
    // True if the sensor can report this pressure. Its output ends at 2.5 and 97.5 % of its supply. Below 1.5 or
    // above 98.5 % a wire is open or shorted. False for NaN.
    bool can_say(Real kPa) const { return kPa >= least_kPa && kPa <= most_kPa; }

    // Pressure difference for the whole supply voltage.
    Real per_share_kPa;
    Real zero_kPa;
    Real least_kPa;
    Real most_kPa;
};

Sensor sensor(Real span_kPa, Real zero_kPa);

Pressures pressures(const Sensor& cv, const Sensor& reservoir, const Readings& readings);

}  // namespace phlosar

#include "sensors.h"

#include <math.h>

namespace phlosar {

namespace {

constexpr Real kZeroShare = Real(0.1);
constexpr Real kPerSpanShare = Real(1.25);
constexpr Real kBeyondSpan = Real(0.10625);

}  // namespace

Sensor sensor(Real span_kPa, Real zero_kPa) {
    const Real beyond_kPa = span_kPa * kBeyondSpan;
    return {kPerSpanShare * span_kPa, zero_kPa, zero_kPa - beyond_kPa, zero_kPa + span_kPa + beyond_kPa};
}

Pressures pressures(const Sensor& cv, const Sensor& reservoir, const Readings& readings) {
    if (readings.supply < kSupplyLeast || readings.supply > kSupplyMost) {
        return {static_cast<Real>(NAN), static_cast<Real>(NAN), false};
    }
    const Real per_count = Real(1) / static_cast<Real>(readings.supply);
    const Real cv_share = static_cast<Real>(readings.cv) * per_count - kZeroShare;
    const Real reservoir_share = static_cast<Real>(readings.reservoir) * per_count - kZeroShare;
    return {
        cv_share * cv.per_share_kPa + cv.zero_kPa,
        reservoir_share * reservoir.per_share_kPa + reservoir.zero_kPa,
        true,
    };
}

}  // namespace phlosar

#include "sensors.h"

#include <math.h>

namespace phlosar {

namespace {

constexpr Real kZeroShare = Real(0.1);
constexpr Real kPerSpanShare = Real(1.25);
constexpr Real kBeyondSpan = Real(0.10625);

}  // namespace

Pressures pressures(const Settings& settings, const Readings& readings) {
    if (readings.supply < kSupplyLeast || readings.supply > kSupplyMost) {
        return {static_cast<Real>(NAN), static_cast<Real>(NAN), false};
    }
    const Real per_count = Real(1) / static_cast<Real>(readings.supply);
    const Real cv_share = static_cast<Real>(readings.cv) * per_count - kZeroShare;
    const Real reservoir_share = static_cast<Real>(readings.reservoir) * per_count - kZeroShare;
    return {
        cv_share * kPerSpanShare * settings[SettingId::kCvSpan_kPa] + settings[SettingId::kCvZero_kPa],
        reservoir_share * kPerSpanShare * settings[SettingId::kReservoirSpan_kPa] +
            settings[SettingId::kReservoirZero_kPa],
        true,
    };
}

bool within_sensor(Real kPa, Real span_kPa, Real zero_kPa) {
    const Real beyond_kPa = span_kPa * kBeyondSpan;
    return kPa >= zero_kPa - beyond_kPa && kPa <= zero_kPa + span_kPa + beyond_kPa;
}

}  // namespace phlosar

// What a lab sets for its rig, and what keeps it over power cycles.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "real.h"

namespace phlosar {

enum class SettingId : uint8_t {
    kCvLimit_kPa,
    kSetpointMargin_kPa,
    kReservoirLimit_kPa,
    kRateLimit_kPa_per_s,
    kDeadMan_ms,
    kTelemetry_Hz,
    kCvSpan_kPa,
    kCvZero_kPa,
    kReservoirSpan_kPa,
    kReservoirZero_kPa,
    kEvpDeadBand,
    kEvpFullDuty,
    kDvpDeadBand,
    kDvpFullDuty,
    kOnOffError_kPa,
    kFillingLead_s,
    kProportional_per_kPa,
    kIntegral_per_kPa_s,
    kVentingLead_s,
};
constexpr uint8_t kSettingCount = 19;

struct SettingRow {
    const char* name;
    Real standard;
    // No message gets beyond these: the dead-man cannot be switched off, nor the limits.
    Real least;
    Real most;
};

// nullptr when there is none of this number.
const SettingRow* setting_row(uint8_t id);

class Settings {
public:
    // The standard values.
    Settings();

    Real operator[](SettingId id) const { return values_[static_cast<uint8_t>(id)]; }
    Real at(uint8_t id) const { return values_[id]; }
    // False, and nothing changes, when there is no such setting or the value is out of its range.
    bool set(uint8_t id, Real value);

    static constexpr size_t kImageSize = 4 + 4 * kSettingCount + 2;
    // As bytes to be kept: kImageSize of them.
    void write_image(uint8_t* image) const;
    // From kept bytes; unless they are good these stay the standard values. False when they are damaged:
    // memory that is erased, or that is not there, is not.
    bool read_image(const uint8_t* image, size_t size);

private:
    Real values_[kSettingCount];
};

}  // namespace phlosar

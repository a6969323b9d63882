// The settings of a rig, and the bytes that store them.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "messages.h"
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
    // No message can exceed these, so neither the dead-man nor a limit can be switched off.
    Real least;
    Real most;
};

// nullptr if there is no such setting.
const SettingRow* setting_row(uint8_t id);

class Settings {
public:
    // The standard values.
    Settings();

    Real operator[](SettingId id) const { return values_[static_cast<uint8_t>(id)]; }
    Real at(uint8_t id) const { return values_[id]; }
    // False if there is no such setting or the value is out of range; then nothing changes.
    bool set(uint8_t id, Real value);

    static constexpr size_t kImageSize = 4 + 4 * kSettingCount + 2;
    // Writes the kImageSize bytes to store.
    void write_image(uint8_t* image) const;
    // Reads stored bytes. If they are damaged, erased or missing, nothing changes.
    SettingsMemory read_image(const uint8_t* image, size_t size);
    // FNV-1a of all values as 32-bit floats, little-endian. A host sees by it that a value has changed.
    uint32_t digest() const;

private:
    Real values_[kSettingCount];
};

}  // namespace phlosar

#include "settings.h"

#include "bytes.h"
#include "framing.h"

namespace phlosar {

namespace {

constexpr uint16_t kMagic = 0x5646;
constexpr uint8_t kImageVersion = 1;

constexpr SettingRow kRows[kSettingCount] = {
    {"cv_limit_kPa", Real(30.0), Real(5.0), Real(60.0)},
    {"setpoint_margin_kPa", Real(2.0), Real(0.5), Real(4.0)},
    {"reservoir_limit_kPa", Real(760.0), Real(50.0), Real(830.0)},
    {"rate_limit_kPa_per_s", Real(200.0), Real(1.0), Real(500.0)},
    {"dead_man_ms", Real(300.0), Real(50.0), Real(300.0)},
    {"telemetry_Hz", Real(100.0), Real(10.0), Real(1000.0)},
    {"cv_span_kPa", Real(206.84), Real(100.0), Real(420.0)},
    {"cv_zero_kPa", Real(0.0), Real(-10.0), Real(10.0)},
    {"reservoir_span_kPa", Real(1500.0), Real(700.0), Real(2000.0)},
    {"reservoir_zero_kPa", Real(0.0), Real(-50.0), Real(50.0)},
    {"evp_dead_band", Real(0.0), Real(0.0), Real(0.6)},
    {"evp_full_duty", Real(0.48), Real(0.05), Real(1.0)},
    {"dvp_dead_band", Real(0.0), Real(0.0), Real(0.6)},
    {"dvp_full_duty", Real(0.95), Real(0.05), Real(1.0)},
    {"on_off_error_kPa", Real(1.5), Real(0.2), Real(10.0)},
    {"filling_lead_s", Real(0.03), Real(0.0), Real(0.2)},
    {"proportional_per_kPa", Real(0.03), Real(0.0), Real(1.0)},
    {"integral_per_kPa_s", Real(1.5), Real(0.0), Real(20.0)},
    {"venting_lead_s", Real(0.02), Real(0.0), Real(0.2)},
};

}  // namespace

const SettingRow* setting_row(uint8_t id) { return id < kSettingCount ? &kRows[id] : nullptr; }

Settings::Settings() {
    for (uint8_t id = 0; id < kSettingCount; ++id) values_[id] = kRows[id].standard;
}

bool Settings::set(uint8_t id, Real value) {
    const SettingRow* row = setting_row(id);
    // This form also refuses NaN.
    if (row == nullptr || !(value >= row->least && value <= row->most)) return false;
    const bool whole = id == static_cast<uint8_t>(SettingId::kDeadMan_ms) ||
                       id == static_cast<uint8_t>(SettingId::kTelemetry_Hz);
    values_[id] = whole ? static_cast<Real>(static_cast<int32_t>(value)) : value;
    // Equal values have one digest, so there is no negative zero.
    if (values_[id] == Real(0)) values_[id] = Real(0);
    return true;
}

void Settings::write_image(uint8_t* image) const {
    Writer writer(image);
    writer.u16(kMagic);
    writer.u8(kImageVersion);
    writer.u8(kSettingCount);
    for (const Real value : values_) writer.f32(static_cast<float>(value));
    writer.u16(crc16(image, writer.size()));
}

SettingsMemory Settings::read_image(const uint8_t* image, size_t size) {
    if (size < 2 || (image[0] == 0xFF && image[1] == 0xFF)) return SettingsMemory::kErased;
    if (size < kImageSize) return SettingsMemory::kDamaged;
    Reader reader(image);
    const bool ours = reader.u16() == kMagic && reader.u8() == kImageVersion && reader.u8() == kSettingCount;
    if (!ours) return SettingsMemory::kDamaged;
    Settings read;
    bool good = true;
    for (uint8_t id = 0; id < kSettingCount; ++id) good = read.set(id, Real(reader.f32())) && good;
    if (!good || reader.u16() != crc16(image, kImageSize - 2)) return SettingsMemory::kDamaged;
    *this = read;
    return SettingsMemory::kStored;
}

uint32_t Settings::digest() const {
    uint32_t digest = 0x811C9DC5;
    for (const Real value : values_) {
        uint8_t bytes[4];
        Writer(bytes).f32(static_cast<float>(value));
        for (const uint8_t byte : bytes) digest = (digest ^ byte) * 0x01000193;
    }
    return digest;
}

}  // namespace phlosar

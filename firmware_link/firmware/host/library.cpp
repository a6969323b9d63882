// The firmware's core as a library for a host, for any language.
//
// No heap: the caller gives the memory for a board. See flying_vines/simulation/phlosar/core_library.py.

#include "../phlosar/src/core/firmware.h"

using phlosar::Boot;
using phlosar::Drive;
using phlosar::Firmware;
using phlosar::Outputs;

#define EXPORTED extern "C" __attribute__((visibility("default")))

inline void* operator new(size_t, Firmware* where) noexcept { return where; }

// Digest of the sources of this library.
EXPORTED const char* phlosar_sources() { return PHLOSAR_SOURCES; }

// Size of the memory for a board. The memory must be aligned to 8 bytes.
EXPORTED size_t phlosar_size() { return sizeof(Firmware); }

// Starts a board in memory of `phlosar_size` bytes. `build` must outlive it.
EXPORTED void phlosar_start(Firmware* firmware, const char* build, uint32_t boot_id, bool by_watchdog,
                            const uint8_t* stored, size_t stored_size) {
    new (firmware) Firmware(build);
    firmware->start(Boot{boot_id, by_watchdog, stored, stored_size});
}

EXPORTED bool phlosar_set(Firmware* firmware, uint8_t id, float value) { return firmware->set(id, value); }

EXPORTED void phlosar_receive(Firmware* firmware, const uint8_t* data, size_t size) {
    firmware->receive(data, size);
}

// Counts in, duty cycles out.
EXPORTED void phlosar_step(Firmware* firmware, uint32_t now_us, uint16_t cv, uint16_t reservoir,
                           uint16_t supply, Outputs* outputs) {
    *outputs = firmware->step(now_us, {cv, reservoir, supply});
}

// As `phlosar_step`: pressures in, openings out.
EXPORTED void phlosar_control(Firmware* firmware, uint32_t now_us, float cv_kPa, float reservoir_kPa,
                              bool supply_good, Drive* told) {
    *told = firmware->control(now_us, {cv_kPa, reservoir_kPa, supply_good});
}

EXPORTED size_t phlosar_take_output(Firmware* firmware, uint8_t* into, size_t size) {
    return firmware->take_output(into, size);
}

EXPORTED uint8_t phlosar_mode(const Firmware* firmware) { return static_cast<uint8_t>(firmware->mode()); }

EXPORTED uint16_t phlosar_faults(const Firmware* firmware) { return firmware->faults(); }

EXPORTED uint16_t phlosar_number(const Firmware* firmware) { return firmware->number(); }

EXPORTED float phlosar_setting(const Firmware* firmware, uint8_t id) { return firmware->settings().at(id); }

// nullptr after the last one.
EXPORTED const phlosar::SettingRow* phlosar_setting_row(uint8_t id) { return phlosar::setting_row(id); }

EXPORTED size_t phlosar_image_size() { return phlosar::Settings::kImageSize; }

// Writes the bytes that store the present settings.
EXPORTED void phlosar_image(const Firmware* firmware, uint8_t* image) { firmware->settings().write_image(image); }

// True once after a change of the settings: `image` then has the bytes to store.
EXPORTED bool phlosar_unsaved(Firmware* firmware, uint8_t* image) { return firmware->unsaved(image); }

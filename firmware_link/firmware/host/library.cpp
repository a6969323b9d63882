// The firmware's core as a library for a host: what flies, called from any language. See compiled_firmware.py.

#include <new>

#include "../phlosar/src/core/firmware.h"

using phlosar::Boot;
using phlosar::Drive;
using phlosar::Firmware;
using phlosar::Outputs;
using phlosar::Real;

extern "C" {

uint32_t phlosar_real_size() { return sizeof(Real); }

// `build` must outlive it. nullptr when there is no memory.
Firmware* phlosar_create(const char* build, uint32_t boot_id, bool by_watchdog, const uint8_t* stored,
                         size_t stored_size) {
    Firmware* firmware = new (std::nothrow) Firmware(build);
    if (firmware != nullptr) firmware->start(Boot{boot_id, by_watchdog, stored, stored_size});
    return firmware;
}

void phlosar_destroy(Firmware* firmware) { delete firmware; }

bool phlosar_set(Firmware* firmware, uint8_t id, double value) {
    return firmware->set(id, static_cast<Real>(value));
}

void phlosar_receive(Firmware* firmware, const uint8_t* data, size_t size) { firmware->receive(data, size); }

// Counts in, duty cycles out. Returns how many bytes wait for the host.
size_t phlosar_step(Firmware* firmware, uint32_t now_us, uint16_t cv, uint16_t reservoir, uint16_t supply,
                    Outputs* outputs) {
    *outputs = firmware->step(now_us, {cv, reservoir, supply});
    return firmware->output_size();
}

struct Openings {
    double evp;
    double dvp;
    bool solenoid;
};

// The same between sensors and valves.
size_t phlosar_control(Firmware* firmware, uint32_t now_us, double cv_kPa, double reservoir_kPa,
                       bool supply_good, Openings* openings) {
    const Drive told =
        firmware->control(now_us, {static_cast<Real>(cv_kPa), static_cast<Real>(reservoir_kPa), supply_good});
    *openings = {static_cast<double>(told.evp), static_cast<double>(told.dvp), told.solenoid};
    return firmware->output_size();
}

size_t phlosar_take_output(Firmware* firmware, uint8_t* into, size_t size) {
    return firmware->take_output(into, size);
}

uint8_t phlosar_mode(const Firmware* firmware) { return static_cast<uint8_t>(firmware->mode()); }

uint16_t phlosar_faults(const Firmware* firmware) { return firmware->faults(); }

uint16_t phlosar_number(const Firmware* firmware) { return firmware->number(); }

double phlosar_setting(const Firmware* firmware, uint8_t id) {
    return static_cast<double>(firmware->settings().at(id));
}

size_t phlosar_image_size() { return phlosar::Settings::kImageSize; }

// Settings to be kept over a reset, once; false while there are none.
bool phlosar_unsaved(Firmware* firmware, uint8_t* image) { return firmware->unsaved(image); }

}  // extern "C"

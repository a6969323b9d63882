// The core's regulator alone, for studies: with any tuning, in double precision.

#define PHLOSAR_REAL double
#define phlosar phlosar_double
#include "../phlosar/src/core/regulator.cpp"

using phlosar::Drive;
using phlosar::Regulator;
using phlosar::Tuning;

#define EXPORTED extern "C" __attribute__((visibility("default")))

inline void* operator new(size_t, Regulator* where) noexcept { return where; }

namespace {

// In the order of Tuning.
constexpr const char* kTuningNames[] = {
    "filter_s",
    "slope_filter_s",
    "on_off_error_kPa",
    "opening_s",
    "filling_lead_s",
    "proportional_per_kPa",
    "integral_per_kPa_s",
    "integral_most",
    "integral_forgets",
    "puff_begins_kPa",
    "puff_ends_kPa",
    "puff_overtakes_kPa",
    "venting_lead_s",
    "tolerated_kPa",
    "patience_kPa_s",
    "warming_s",
    "waiting_s",
    "active_error_kPa",
    "passive_error_kPa",
    "passive_first_s",
    "arrival_s",
    "venturi_least_supply_kPa",
};
constexpr size_t kTuningCount = sizeof kTuningNames / sizeof *kTuningNames;
static_assert(sizeof(Tuning) == kTuningCount * sizeof(double), "each member has its name");

struct Told {
    double evp;
    double dvp;
    // 0 or 1.
    double solenoid;
    double setpoint_kPa;
};

}  // namespace

EXPORTED size_t phlosar_tuning_count() { return kTuningCount; }

EXPORTED const char* phlosar_tuning_name(size_t index) { return kTuningNames[index]; }

EXPORTED void phlosar_standard_tuning(Tuning* tuning) { *tuning = Tuning{}; }

EXPORTED size_t phlosar_regulator_size() { return sizeof(Regulator); }

// Starts a regulator in memory of `phlosar_regulator_size` bytes, aligned to 8 bytes.
EXPORTED void phlosar_regulator_start(Regulator* regulator, const Tuning* tuning) {
    new (regulator) Regulator();
    regulator->configure(*tuning);
}

EXPORTED void phlosar_regulator_begin(Regulator* regulator, double cv_kPa) { regulator->begin(cv_kPa); }

// One step of a millisecond. The setpoint moves towards the target, at most at this rate.
EXPORTED void phlosar_regulator_step(Regulator* regulator, double target_kPa, double rate_kPa_per_s,
                                     double cv_kPa, double reservoir_kPa, Told* told) {
    const double most_kPa = rate_kPa_per_s * phlosar::kStep_s;
    const Drive drive = regulator->step(target_kPa, most_kPa, cv_kPa, reservoir_kPa);
    *told = {drive.evp, drive.dvp, drive.solenoid ? 1.0 : 0.0, regulator->setpoint_kPa()};
}

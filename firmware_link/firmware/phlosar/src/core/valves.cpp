#include "valves.h"

namespace phlosar {

namespace {

Real lifted(Real opening, Real dead_band) {
    return opening > Real(0) ? dead_band + (Real(1) - dead_band) * opening : Real(0);
}

uint16_t duty(Real opening, Real full_duty) {
    if (!(opening > Real(0))) return 0;
    const Real share = smaller(Real(1), opening) * full_duty;
    return static_cast<uint16_t>(static_cast<int32_t>(share * Real(65535) + Real(0.5)));
}

}  // namespace

Drive over_dead_bands(const Settings& settings, const Drive& wanted) {
    return {lifted(wanted.evp, settings[SettingId::kEvpDeadBand]),
            lifted(wanted.dvp, settings[SettingId::kDvpDeadBand]), wanted.solenoid};
}

Outputs outputs(const Settings& settings, const Drive& told) {
    return {duty(told.evp, settings[SettingId::kEvpFullDuty]),
            duty(told.dvp, settings[SettingId::kDvpFullDuty]), told.solenoid};
}

}  // namespace phlosar

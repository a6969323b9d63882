#include "valves.h"

namespace phlosar {

namespace {

Real lifted(Real opening, Real dead_band) {
    return opening > Real(0) ? dead_band + (Real(1) - dead_band) * opening : Real(0);
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

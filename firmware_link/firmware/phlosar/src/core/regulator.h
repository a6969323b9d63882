// The paper's pressure regulator for real valves: on-off when far from the setpoint, PID when near.
//
// A real inflation valve does nothing below some opening, follows late, and has play; a solenoid lets out air
// for a while after it is told to close. So what counts is the pressure where it will be once the valves have
// followed, and the opening from which on air flows is learned: it is the integral, which stays when the valve
// shuts. Near the setpoint air goes in by puffs, each just large enough to pass it. Air leaves by itself where
// that is fast enough; only otherwise does the Venturi help, for it costs air.
#pragma once

#include "real.h"
#include "settings.h"
#include "valves.h"

namespace phlosar {

// Seconds from one control step to the next, by design: the regulator does not follow a jittering clock.
constexpr Real kStep_s = Real(0.001);

// Below it the Venturi spends air and makes no vacuum to speak of.
constexpr Real kVenturiLeastSupply_kPa = Real(100.0);

class Regulator {
public:
    // Once before anything else, and whenever settings change.
    void configure(const Settings& settings);

    // A regulation begins: the setpoint is the measured pressure, so that nothing jumps.
    void begin(Real cv_kPa);

    // The valves for the next step, from pressures just read. The setpoint goes towards the target.
    Drive step(Real target_kPa, Real most, Real cv_kPa, Real reservoir_kPa);

    // What is held now, on its way to the target.
    Real setpoint_kPa() const { return setpoint_kPa_; }

private:
    Real inflation(Real error, Real closing, Real reservoir_kPa);
    bool venturi(Real error, Real setpoint_slope, Real slope, Real reservoir_kPa) const;

    Real on_off_error_kPa_ = 0;
    Real filling_lead_s_ = 0;
    Real proportional_ = 0;
    Real integral_per_kPa_s_ = 0;
    Real venting_lead_s_ = 0;

    Real setpoint_kPa_ = 0;
    Real cv_kPa_ = 0;
    Real slope_kPa_per_s_ = 0;
    // The opening at which air begins to flow, as far as it is known.
    Real integral_ = 0;
    // As told last.
    Real evp_ = 0;
    Real excess_kPa_s_ = 0;
    // For how long the solenoid has been told to be open; below 0, for how long air that was let out is given
    // time to warm.
    Real venting_s_ = 0;
    bool venturi_ = false;
};

}  // namespace phlosar

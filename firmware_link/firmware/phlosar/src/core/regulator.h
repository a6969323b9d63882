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

// What a regulator can be tuned with. These values are good from 0.05 to 1 litre, on 100 to 690 kPa.
struct Tuning {
    Real filter_s = Real(0.003);
    Real slope_filter_s = Real(0.008);
    // Of the predicted pressure. Farther below the setpoint the inflation valve goes fully open, in
    // `opening_s`: air that flows before the sensor shows it would otherwise be too much for a small vine.
    Real on_off_error_kPa = Real(1.5);
    Real opening_s = Real(0.12);
    // Prediction time while air goes in: delay and lag of valve, sensor and filters.
    Real filling_lead_s = Real(0.03);
    // On 690 kPa; on less it grows in proportion, because choked flow goes with the absolute pressure.
    Real proportional_per_kPa = Real(0.03);
    Real integral_per_kPa_s = Real(1.5);
    // Beyond the largest dead zone.
    Real integral_most = Real(0.55);
    // With each puff, so that the next one begins with no flow.
    Real integral_forgets = Real(0.015);
    // Below and above the setpoint.
    Real puff_begins_kPa = Real(0.15);
    Real puff_ends_kPa = Real(0.05);
    // A puff also ends when the predicted pressure is this much above the setpoint.
    Real puff_overtakes_kPa = Real(0.25);
    // How long the solenoid lets air out after it is told to close.
    Real venting_lead_s = Real(0.02);
    // Above the setpoint. A larger excess is let out when its integral over time reaches `patience_kPa_s`:
    // after a fill gas cools, and the pressure falls by itself.
    Real tolerated_kPa = Real(0.3);
    Real patience_kPa_s = Real(0.06);
    // After a vent gas warms, and the pressure rises by itself: nothing is filled up before.
    Real warming_s = Real(0.15);
    // An excess over a moving setpoint is left alone if the setpoint will be there within this time.
    Real waiting_s = Real(0.3);
    // The Venturi starts only above the first error and stops below the second.
    Real active_error_kPa = Real(3.0);
    Real passive_error_kPa = Real(1.0);
    // How long air leaves by itself before its speed is judged.
    Real passive_first_s = Real(0.03);
    // Within this time the pressure should arrive at a setpoint that stands still.
    Real arrival_s = Real(0.3);
    Real venturi_least_supply_kPa = kVenturiLeastSupply_kPa;
};

// The standard values, and those of a lab's settings.
Tuning tuning(const Settings& settings);

class Regulator {
public:
    // Once before anything else, and whenever the tuning changes.
    void configure(const Tuning& tuning);

    // A regulation begins: the setpoint is the measured pressure, so that nothing jumps.
    void begin(Real cv_kPa);

    // The valves for the next step, from pressures just read. The setpoint goes towards the target.
    Drive step(Real target_kPa, Real most, Real cv_kPa, Real reservoir_kPa);

    // What is held now, on its way to the target.
    Real setpoint_kPa() const { return setpoint_kPa_; }

private:
    Real inflation(Real error, Real closing, Real reservoir_kPa);
    bool venturi(Real error, Real setpoint_slope, Real slope, Real reservoir_kPa) const;

    Tuning tuning_;
    // What the tuning comes to in a step, so that a step need not divide.
    Real filter_ = 0;
    Real slope_filter_ = 0;
    Real opening_ = 0;
    Real proportional_ = 0;

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

// The paper's pressure regulator, adapted to real valves: on-off far from the setpoint, PID near it.
//
// A real inflation valve has a dead zone, a delay and play. A solenoid lets out air for a while after it is told
// to close. So the regulator uses the pressure that is predicted for the time when the valves have followed their
// commands. The integral learns the opening at which air begins to flow, and keeps it while the valve is shut.
// Near the setpoint air goes in by puffs, each just large enough to pass the setpoint. The Venturi costs air, so
// it runs only if venting without it is too slow.
#pragma once

#include "real.h"
#include "settings.h"
#include "valves.h"

namespace phlosar {

// Nominal time of a control step. The regulator does not use measured times, because they jitter.
constexpr Real kStep_s = Real(0.001);

// At a lower supply pressure the Venturi uses air but makes hardly any vacuum.
constexpr Real kVenturiLeastSupply_kPa = Real(100.0);

// The regulator's tuning. The defaults suit vines of 0.05 to 1 litre, on 100 to 690 kPa.
struct Tuning {
    Real filter_s = Real(0.003);
    Real slope_filter_s = Real(0.008);
    // If the predicted pressure is below the setpoint by more than this, the inflation valve opens fully, within
    // `opening_s`. A faster opening would overfill a small vine before the sensor shows the flow.
    Real on_off_error_kPa = Real(1.5);
    Real opening_s = Real(0.12);
    // Prediction time while filling: delay and lag of valve, sensor and filters.
    Real filling_lead_s = Real(0.03);
    // Gain at a supply of 690 kPa. A lower supply needs a higher gain, because choked flow is proportional to the
    // absolute pressure.
    Real proportional_per_kPa = Real(0.03);
    Real integral_per_kPa_s = Real(1.5);
    // Maximum of the integral, above the largest dead zone.
    Real integral_most = Real(0.55);
    // Reduction of the integral after each puff, so that the next one begins without flow.
    Real integral_forgets = Real(0.015);
    // A puff begins this much below the setpoint, and ends this much above it.
    Real puff_begins_kPa = Real(0.15);
    Real puff_ends_kPa = Real(0.05);
    // A puff also ends when the predicted pressure is this much above the setpoint.
    Real puff_overtakes_kPa = Real(0.25);
    // How long the solenoid lets air out after it is told to close.
    Real venting_lead_s = Real(0.02);
    // Tolerated excess over the setpoint. A larger excess is not vented at once, because after a fill the gas cools
    // and the pressure falls by itself. The part above the tolerance is integrated over time, and air is let out
    // when the integral exceeds `patience_kPa_s`.
    Real tolerated_kPa = Real(0.3);
    Real patience_kPa_s = Real(0.06);
    // After a vent the gas warms, and the pressure rises by itself. Filling waits for this time.
    Real warming_s = Real(0.15);
    // An error is ignored if the moving setpoint reaches the pressure within this time.
    Real waiting_s = Real(0.3);
    // The Venturi starts only if the pressure is above the setpoint by the first value, and stops below the second.
    Real active_error_kPa = Real(3.0);
    Real passive_error_kPa = Real(1.0);
    // Minimum time of venting without the Venturi before the Venturi may start.
    Real passive_first_s = Real(0.03);
    // The Venturi starts if venting without it would take longer than this to reach a constant setpoint.
    Real arrival_s = Real(0.3);
    Real venturi_least_supply_kPa = kVenturiLeastSupply_kPa;
};

// The defaults, with the values of the settings.
Tuning tuning(const Settings& settings);

class Regulator {
public:
    // Call it before anything else, and after each change of the tuning.
    void configure(const Tuning& tuning);

    // Begins a regulation. The setpoint starts at the measured pressure, so that it does not jump.
    void begin(Real cv_kPa);

    // The openings for the next step. The setpoint moves towards the target, by at most `most` kPa.
    Drive step(Real target_kPa, Real most, Real cv_kPa, Real reservoir_kPa);

    // The present setpoint, on its way to the target.
    Real setpoint_kPa() const { return setpoint_kPa_; }

private:
    Real inflation(Real error, Real closing, Real reservoir_kPa);
    bool venturi(Real error, Real setpoint_slope, Real slope, Real reservoir_kPa) const;

    Tuning tuning_;
    // Computed once from the tuning, to save divisions in a step.
    Real filter_ = 0;
    Real slope_filter_ = 0;
    Real opening_ = 0;
    Real proportional_ = 0;

    Real setpoint_kPa_ = 0;
    Real cv_kPa_ = 0;
    Real slope_kPa_per_s_ = 0;
    // Estimate of the opening at which air begins to flow.
    Real integral_ = 0;
    // The latest commanded opening.
    Real evp_ = 0;
    Real excess_kPa_s_ = 0;
    // Above 0: time since the solenoid was told to open. Below 0: after a vent, minus the time that the gas still
    // has to warm.
    Real venting_s_ = 0;
    bool venturi_ = false;
};

}  // namespace phlosar

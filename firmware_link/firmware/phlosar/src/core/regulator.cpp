#include "regulator.h"

namespace phlosar {

namespace {

constexpr Real kRatedSupply_kPa_abs = Real(791.0);
constexpr Real kAmbient_kPa = Real(101.0);
constexpr Real kFirstIntegral = Real(0.2);

constexpr Real kPerStep_s = Real(1.0) / kStep_s;
}  // namespace

Tuning tuning(const Settings& settings) {
    Tuning tuned;
    tuned.on_off_error_kPa = settings[SettingId::kOnOffError_kPa];
    tuned.filling_lead_s = settings[SettingId::kFillingLead_s];
    tuned.proportional_per_kPa = settings[SettingId::kProportional_per_kPa];
    tuned.integral_per_kPa_s = settings[SettingId::kIntegral_per_kPa_s];
    tuned.venting_lead_s = settings[SettingId::kVentingLead_s];
    return tuned;
}

void Regulator::configure(const Tuning& tuning) {
    tuning_ = tuning;
    filter_ = kStep_s / (tuning.filter_s + kStep_s);
    slope_filter_ = kStep_s / (tuning.slope_filter_s + kStep_s);
    opening_ = kStep_s / tuning.opening_s;
    proportional_ = tuning.proportional_per_kPa * kRatedSupply_kPa_abs;
}

void Regulator::begin(Real cv_kPa) {
    setpoint_kPa_ = larger(Real(0), cv_kPa);
    cv_kPa_ = cv_kPa;
    slope_kPa_per_s_ = 0;
    integral_ = kFirstIntegral;
    evp_ = 0;
    excess_kPa_s_ = 0;
    venting_s_ = 0;
    venturi_ = false;
}

Drive Regulator::step(Real target_kPa, Real most, Real cv_kPa, Real reservoir_kPa) {
    const Real move = smaller(most, larger(-most, target_kPa - setpoint_kPa_));
    const Real setpoint_slope = move * kPerStep_s;
    setpoint_kPa_ += move;
    const Real change = (cv_kPa - cv_kPa_) * filter_;
    cv_kPa_ += change;
    slope_kPa_per_s_ += (change * kPerStep_s - slope_kPa_per_s_) * slope_filter_;
    const Real error = setpoint_kPa_ - cv_kPa_;
    const Real closing = setpoint_slope - slope_kPa_per_s_;

    bool vent;
    Real excess_kPa_s = 0;
    if (venting_s_ > Real(0)) {
        vent = error + closing * tuning_.venting_lead_s < Real(0);
    } else {
        const Real excess = -error - tuning_.tolerated_kPa - larger(Real(0), setpoint_slope) * tuning_.waiting_s;
        if (excess > Real(0)) excess_kPa_s = excess_kPa_s_ + excess * kStep_s;
        vent = excess_kPa_s > tuning_.patience_kPa_s;
    }
    excess_kPa_s_ = excess_kPa_s;

    Real evp = 0;
    bool with_venturi = false;
    // At a setpoint of 0 the solenoid stays open, so that air that leaks in can leave.
    if (vent || setpoint_kPa_ <= Real(0)) {
        with_venturi = venturi(error, setpoint_slope, slope_kPa_per_s_, reservoir_kPa);
        venting_s_ = larger(Real(0), venting_s_) + kStep_s;
    } else {
        venting_s_ = venting_s_ > Real(0) ? -tuning_.warming_s : smaller(Real(0), venting_s_ + kStep_s);
        const bool warm = venting_s_ == Real(0) || move > Real(0);
        const bool needed = move >= Real(0) || error > -setpoint_slope * tuning_.waiting_s;
        if (warm && needed) evp = inflation(error, closing, reservoir_kPa);
    }
    evp_ = evp;
    venturi_ = with_venturi;
    return {evp, with_venturi ? Real(1) : Real(0), venting_s_ > Real(0)};
}

// Opening of the inflation valve. `closing` is the rate of change of `error`, kPa/s.
Real Regulator::inflation(Real error, Real closing, Real reservoir_kPa) {
    const Real ahead = error + closing * tuning_.filling_lead_s;
    if (error > Real(0) && ahead > tuning_.on_off_error_kPa) {
        return smaller(Real(1), larger(evp_, integral_) + opening_);
    }
    const bool in_puff = evp_ > Real(0);
    const bool wanted = in_puff ? error > -tuning_.puff_ends_kPa : error > tuning_.puff_begins_kPa;
    if (wanted && ahead > -tuning_.puff_overtakes_kPa) {
        integral_ += tuning_.integral_per_kPa_s * larger(Real(0), error) * kStep_s;
        integral_ = smaller(tuning_.integral_most, integral_);
        if (!(ahead > Real(0))) return smaller(Real(1), integral_);
        const Real supply_kPa_abs = larger(Real(0), reservoir_kPa) + kAmbient_kPa;
        const Real gain = proportional_ / supply_kPa_abs;
        return smaller(Real(1), integral_ + gain * ahead);
    }
    if (in_puff) {
        // Reduce more if the predicted overshoot exceeds the present error. Far below the setpoint a fast rise
        // is needed.
        const Real forgotten = tuning_.integral_forgets * (Real(1) + larger(Real(0), -ahead - error));
        integral_ = larger(Real(0), integral_ - forgotten);
    }
    return 0;
}

// True if the Venturi must help to vent.
bool Regulator::venturi(Real error, Real setpoint_slope, Real slope, Real reservoir_kPa) const {
    if (reservoir_kPa < tuning_.venturi_least_supply_kPa || error > -tuning_.passive_error_kPa) return false;
    if (venturi_ || error > -tuning_.active_error_kPa || venting_s_ < tuning_.passive_first_s) return venturi_;
    return -slope * tuning_.arrival_s < larger(-setpoint_slope * tuning_.arrival_s, -error);
}

}  // namespace phlosar

#include "regulator.h"

namespace phlosar {

namespace {

constexpr Real kRatedSupply_kPa_abs = Real(791.0);
constexpr Real kAmbient_kPa = Real(101.0);
constexpr Real kFirstIntegral = Real(0.2);

constexpr Real kPerStep_s = Real(1.0) / kStep_s;
constexpr Real kFilter = kStep_s / (Real(0.003) + kStep_s);
constexpr Real kSlopeFilter = kStep_s / (Real(0.008) + kStep_s);
// Farther below the setpoint the inflation valve goes fully open in this time: what flows before the sensor
// tells would otherwise be too much for a small vine.
constexpr Real kOpening = kStep_s / Real(0.12);
// Beyond the largest dead zone.
constexpr Real kIntegralMost = Real(0.55);
// With each puff, so that the next one begins with no flow.
constexpr Real kIntegralForgets = Real(0.015);
constexpr Real kPuffBegins_kPa = Real(0.15);
constexpr Real kPuffEnds_kPa = Real(0.05);
// A puff also ends when the pressure to come is this much above the setpoint.
constexpr Real kPuffOvertakes_kPa = Real(0.25);
// Above the setpoint. More is let out, the more the sooner, when excess times time comes to the second.
constexpr Real kTolerated_kPa = Real(0.3);
constexpr Real kPatience_kPa_s = Real(0.06);
// After a vent gas warms, and rises by itself: what fell too far is not filled up before.
constexpr Real kWarming_s = Real(0.15);
// What is beyond a setpoint that moves is left alone if the setpoint will be there within this.
constexpr Real kWaiting_s = Real(0.3);
// Nearer than the first the Venturi is not started, nearer than the second it is stopped.
constexpr Real kActiveError_kPa = Real(3.0);
constexpr Real kPassiveError_kPa = Real(1.0);
// How long air may leave by itself before its speed is judged.
constexpr Real kPassiveFirst_s = Real(0.03);
// Within this the pressure should arrive at a setpoint that stands still.
constexpr Real kArrival_s = Real(0.3);

}  // namespace

void Regulator::configure(const Settings& settings) {
    on_off_error_kPa_ = settings[SettingId::kOnOffError_kPa];
    filling_lead_s_ = settings[SettingId::kFillingLead_s];
    proportional_ = settings[SettingId::kProportional_per_kPa] * kRatedSupply_kPa_abs;
    integral_per_kPa_s_ = settings[SettingId::kIntegral_per_kPa_s];
    venting_lead_s_ = settings[SettingId::kVentingLead_s];
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
    const Real change = (cv_kPa - cv_kPa_) * kFilter;
    cv_kPa_ += change;
    slope_kPa_per_s_ += (change * kPerStep_s - slope_kPa_per_s_) * kSlopeFilter;
    const Real error = setpoint_kPa_ - cv_kPa_;
    const Real closing = setpoint_slope - slope_kPa_per_s_;

    bool vent;
    Real excess_kPa_s = 0;
    if (venting_s_ > Real(0)) {
        vent = error + closing * venting_lead_s_ < Real(0);
    } else {
        const Real excess = -error - kTolerated_kPa - larger(Real(0), setpoint_slope) * kWaiting_s;
        if (excess > Real(0)) excess_kPa_s = excess_kPa_s_ + excess * kStep_s;
        vent = excess_kPa_s > kPatience_kPa_s;
    }
    excess_kPa_s_ = excess_kPa_s;

    Real evp = 0;
    bool with_venturi = false;
    // At rest whatever is left, or leaks in, may leave.
    if (vent || setpoint_kPa_ <= Real(0)) {
        with_venturi = venturi(error, setpoint_slope, slope_kPa_per_s_, reservoir_kPa);
        venting_s_ = larger(Real(0), venting_s_) + kStep_s;
    } else {
        venting_s_ = venting_s_ > Real(0) ? -kWarming_s : smaller(Real(0), venting_s_ + kStep_s);
        const bool warm = venting_s_ == Real(0) || move > Real(0);
        const bool needed = move >= Real(0) || error > -setpoint_slope * kWaiting_s;
        if (warm && needed) evp = inflation(error, closing, reservoir_kPa);
    }
    evp_ = evp;
    venturi_ = with_venturi;
    return {evp, with_venturi ? Real(1) : Real(0), venting_s_ > Real(0)};
}

// The inflation valve; `closing` is how fast the setpoint runs away, kPa/s.
Real Regulator::inflation(Real error, Real closing, Real reservoir_kPa) {
    const Real ahead = error + closing * filling_lead_s_;
    if (error > Real(0) && ahead > on_off_error_kPa_) {
        return smaller(Real(1), larger(evp_, integral_) + kOpening);
    }
    const bool in_puff = evp_ > Real(0);
    const bool wanted = in_puff ? error > -kPuffEnds_kPa : error > kPuffBegins_kPa;
    if (wanted && ahead > -kPuffOvertakes_kPa) {
        integral_ += integral_per_kPa_s_ * larger(Real(0), error) * kStep_s;
        integral_ = smaller(kIntegralMost, integral_);
        if (!(ahead > Real(0))) return smaller(Real(1), integral_);
        const Real supply_kPa_abs = larger(Real(0), reservoir_kPa) + kAmbient_kPa;
        const Real gain = proportional_ / supply_kPa_abs;
        return smaller(Real(1), integral_ + gain * ahead);
    }
    if (in_puff) {
        // More after a puff from near that runs far beyond; one from afar has to run.
        const Real forgotten = kIntegralForgets * (Real(1) + larger(Real(0), -ahead - error));
        integral_ = larger(Real(0), integral_ - forgotten);
    }
    return 0;
}

// Whether the Venturi helps to let air out.
bool Regulator::venturi(Real error, Real setpoint_slope, Real slope, Real reservoir_kPa) const {
    if (reservoir_kPa < kVenturiLeastSupply_kPa || error > -kPassiveError_kPa) return false;
    if (venturi_ || error > -kActiveError_kPa || venting_s_ < kPassiveFirst_s) return venturi_;
    return -slope * kArrival_s < larger(-setpoint_slope * kArrival_s, -error);
}

}  // namespace phlosar

#include "firmware.h"

namespace phlosar {

void Firmware::start(const Boot& boot) {
    boot_id_ = boot.boot_id;
    if (boot.by_watchdog) latch(kWatchdogReset);
    settings_memory_ = settings_.read_image(boot.stored, boot.stored_size);
    if (settings_memory_ == SettingsMemory::kDamaged) latch(kSettings);
    configure();
}

void Firmware::configure() {
    regulator_.configure(tuning(settings_));
    cv_sensor_ = sensor(settings_[SettingId::kCvSpan_kPa], settings_[SettingId::kCvZero_kPa]);
    reservoir_sensor_ =
        sensor(settings_[SettingId::kReservoirSpan_kPa], settings_[SettingId::kReservoirZero_kPa]);
    telemetry_period_us_ = 1000000u / static_cast<uint32_t>(settings_[SettingId::kTelemetry_Hz]);
}

bool Firmware::set(uint8_t id, Real value) {
    if (!settings_.set(id, value)) return false;
    configure();
    return true;
}

bool Firmware::unsaved(uint8_t* image) {
    if (!settings_changed_) return false;
    settings_changed_ = false;
    settings_memory_ = SettingsMemory::kStored;
    settings_.write_image(image);
    return true;
}

Mode Firmware::mode() const {
    if (latched_ != kNoFault) return Mode::kFault;
    return regulating_ ? Mode::kRegulate : Mode::kVent;
}

void Firmware::receive(const uint8_t* data, size_t size) {
    if (!stepped_) return;
    for (size_t i = 0; i < size; ++i) {
        if (frames_.push(data[i])) handle(parse(frames_.payload(), frames_.size()));
    }
}

Outputs Firmware::step(uint32_t now_us, const Readings& readings) {
    return outputs(settings_, control(now_us, pressures(cv_sensor_, reservoir_sensor_, readings)));
}

Drive Firmware::control(uint32_t now_us, const Pressures& pressures) {
    const bool first = !stepped_;
    follow_clock(now_us);
    look(pressures);
    if (first) steady_cv_kPa_ = cv_kPa_;
    if (regulating_ && now_us - commanded_us_ >= holds_us_) latch(kDeadMan);
    Drive told = kSafe;
    told.dvp = relief();
    if (regulating_) {
        const Drive wanted = regulator_.step(target_kPa_, most_per_step_kPa_, cv_kPa_, reservoir_kPa_);
        told = over_dead_bands(settings_, wanted);
        if (low_supply_steps_ > 0) told.dvp = 0;
    }
    if (blows_back(told.dvp > Real(0))) {
        latch(kVenturi);
        told = kSafe;
    }
    if (static_cast<int32_t>(now_us - telemetry_us_) >= 0) tell_telemetry(told);
    return told;
}

// Above the limit the Venturi runs: a valve that is stuck open may let in more air than the outlet lets out.
// The steps add up, and clearing the fault does not start the count anew: a routine request clears it too.
Real Firmware::relief() {
    if ((latched_ & kCvOverpressure) == 0) {
        if (++regained_steps_ >= kReliefRegain) {
            regained_steps_ = 0;
            if (relief_steps_ > 0) --relief_steps_;
        }
    } else if ((latched_ & kVenturi) == 0 && above_limit_ && relief_steps_ < kMostRelief && low_supply_steps_ == 0) {
        ++relief_steps_;
        return Real(1);
    }
    return Real(0);
}

bool Firmware::blows_back(bool venturi_runs) {
    const Real away_kPa = cv_kPa_ - steady_cv_kPa_;
    steady_cv_kPa_ += smaller(kSteadyMost_kPa, larger(-kSteadyMost_kPa, away_kPa)) * kSteadyFilter;
    if (!venturi_runs) {
        venturi_steps_ = 0;
        venturi_raises_ = Frequent();
        return false;
    }
    const bool settling = !regulating_ && venturi_steps_ < kReliefSettles;
    if (venturi_steps_ == 0 || settling || steady_cv_kPa_ < venturi_lowest_kPa_) venturi_lowest_kPa_ = steady_cv_kPa_;
    if (venturi_steps_ < kReliefSettles) ++venturi_steps_;
    venturi_raises_.see(!settling && cv_kPa_ > venturi_lowest_kPa_ + kBlowsBack_kPa);
    return venturi_raises_.there();
}

void Firmware::follow_clock(uint32_t now_us) {
    if (!stepped_) {
        stepped_ = true;
        telemetry_us_ = now_us;
        millisecond_us_ = now_us;
    }
    now_us_ = now_us;
    const uint32_t ms = (now_us - millisecond_us_) / 1000;
    time_ms_ += ms;
    millisecond_us_ += 1000 * ms;
}

// Keeps valid readings, and latches the faults that they show.
void Firmware::look(const Pressures& seen) {
    const bool cv_good = cv_sensor_.can_say(seen.cv_kPa);
    const bool reservoir_good = reservoir_sensor_.can_say(seen.reservoir_kPa);
    if (cv_good) cv_kPa_ = seen.cv_kPa;
    if (reservoir_good) reservoir_kPa_ = seen.reservoir_kPa;
    if (reservoir_kPa_ < kVenturiLeastSupply_kPa) {
        low_supply_steps_ = kLowSupply;
    } else if (low_supply_steps_ > 0) {
        --low_supply_steps_;
    }
    bad_cv_.see(!cv_good);
    bad_reservoir_.see(!reservoir_good);
    bad_supply_.see(!seen.supply_good);
    above_limit_ = cv_good && cv_kPa_ > settings_[SettingId::kCvLimit_kPa];
    // An invalid reading counts neither as above nor as below a limit.
    if (cv_good) high_cv_.see(above_limit_);
    if (reservoir_good) high_reservoir_.see(reservoir_kPa_ > settings_[SettingId::kReservoirLimit_kPa]);
    uint16_t present = kNoFault;
    const auto note = [&present](bool there, Fault fault) {
        if (there) present = static_cast<uint16_t>(present | fault);
    };
    note(bad_cv_.there(), kCvSensor);
    note(bad_reservoir_.there(), kReservoirSensor);
    note(bad_supply_.there(), kSupply);
    note(high_cv_.there(), kCvOverpressure);
    note(high_reservoir_.there(), kReservoirOverpressure);
    // Above the limit a cleared fault would let the Venturi try again.
    note(high_cv_.there() && (latched_ & kVenturi) != 0, kVenturi);
    present_ = present;
    if (present != kNoFault) latch(present);
}

void Firmware::latch(uint16_t faults) {
    latched_ = static_cast<uint16_t>(latched_ | faults);
    regulating_ = false;
}

void Firmware::handle(const HostMessage& message) {
    using Type = HostMessage::Type;
    switch (message.type) {
        case Type::kHello:
            on_hello(message.hello);
            break;
        case Type::kSetpoint:
            on_setpoint(message.setpoint);
            break;
        case Type::kVent:
            regulating_ = false;
            accept(message.vent.number);
            break;
        case Type::kClearFaults:
            if (greeted_) {
                // Damaged settings stay a fault until settings are stored again: with the standard ones
                // pressures may read half of the true ones.
                const bool damaged = settings_memory_ == SettingsMemory::kDamaged;
                const int stays = present_ | (damaged ? kSettings : kNoFault);
                latched_ = static_cast<uint16_t>(latched_ & ~(message.clear_faults.mask & ~stays));
            } else {
                refuse(0, RefusalReason::kNoHandshake);
            }
            break;
        case Type::kPing:
            send(Pong{message.ping.host_time_us, time_ms_});
            break;
        case Type::kGetSetting:
            tell_setting(message.get_setting.id);
            break;
        case Type::kSetSetting:
            on_set_setting(message.set_setting);
            break;
        case Type::kNone:
            break;
    }
}

void Firmware::on_hello(const Hello& hello) {
    regulating_ = false;
    counting_ = false;
    // Setpoints of an earlier session are refused, also if a line repeats them behind their `Hello`.
    session_ = boot_id_ * 0x9E3779B1u + ++greetings_;
    settings_told_ = true;
    setpoint_count_ = 0;
    greeted_ = hello.protocol_version == kProtocolVersion;
    Welcome welcome{};
    welcome.nonce = hello.nonce;
    welcome.boot_id = boot_id_;
    welcome.firmware_build = build_;
    welcome.cv_limit_kPa = static_cast<float>(settings_[SettingId::kCvLimit_kPa]);
    welcome.setpoint_limit_kPa = static_cast<float>(setpoint_most_kPa());
    welcome.reservoir_limit_kPa = static_cast<float>(settings_[SettingId::kReservoirLimit_kPa]);
    welcome.rate_limit_kPa_per_s = static_cast<float>(settings_[SettingId::kRateLimit_kPa_per_s]);
    welcome.dead_man_ms = static_cast<uint16_t>(settings_[SettingId::kDeadMan_ms]);
    welcome.telemetry_Hz = static_cast<uint16_t>(settings_[SettingId::kTelemetry_Hz]);
    welcome.session = session_;
    welcome.settings_digest = settings_.digest();
    welcome.settings_memory = settings_memory_;
    send(welcome);
    if (!greeted_) refuse(0, RefusalReason::kVersion);
}

void Firmware::on_setpoint(const Setpoint& setpoint) {
    if (repeated(setpoint)) return;
    RefusalReason reason;
    if (why_refused(setpoint, &reason)) {
        refuse(setpoint.number, reason);
        return;
    }
    if (!regulating_) {
        regulating_ = true;
        regulator_.begin(cv_kPa_);
        steady_cv_kPa_ = cv_kPa_;
    }
    target_kPa_ = Real(setpoint.target_kPa);
    most_per_step_kPa_ =
        smaller(Real(setpoint.rate_kPa_per_s), settings_[SettingId::kRateLimit_kPa_per_s]) * kStep_s;
    const uint16_t dead_man_ms = static_cast<uint16_t>(settings_[SettingId::kDeadMan_ms]);
    holds_us_ = 1000u * (setpoint.ttl_ms < dead_man_ms ? setpoint.ttl_ms : dead_man_ms);
    commanded_us_ = now_us_;
    accept(setpoint.number);
}

// True if it has come before. A line that repeats its last bytes must not hold the dead-man off.
bool Firmware::repeated(const Setpoint& setpoint) {
    if (!of_this_session(setpoint)) return false;
    if (setpoint.count <= setpoint_count_) return true;
    setpoint_count_ = setpoint.count;
    return false;
}

void Firmware::accept(uint16_t number) {
    number_ = number;
    if (!overtaken(number)) newest_ = number;
    counting_ = true;
}

bool Firmware::overtaken(uint16_t number) const {
    return counting_ && static_cast<int16_t>(static_cast<uint16_t>(number - newest_)) < 0;
}

bool Firmware::why_refused(const Setpoint& setpoint, RefusalReason* reason) const {
    const bool within = setpoint.target_kPa >= 0.0f && Real(setpoint.target_kPa) <= setpoint_most_kPa();
    if (!of_this_session(setpoint)) {
        *reason = RefusalReason::kNoHandshake;
    } else if (!is_finite(setpoint.target_kPa) || !is_finite(setpoint.rate_kPa_per_s)) {
        *reason = RefusalReason::kNotANumber;
    } else if (!within || !(setpoint.rate_kPa_per_s > 0.0f) || setpoint.ttl_ms == 0) {
        *reason = RefusalReason::kOutOfRange;
    } else if (latched_ != kNoFault) {
        *reason = RefusalReason::kFaultLatched;
    } else if (overtaken(setpoint.number)) {
        *reason = RefusalReason::kOvertaken;
    } else {
        return false;
    }
    return true;
}

void Firmware::on_set_setting(const SetSetting& set_setting) {
    if (!greeted_) {
        refuse(0, RefusalReason::kNoHandshake);
    } else if (!is_finite(set_setting.value)) {
        refuse(0, RefusalReason::kNotANumber);
    } else if (regulating_) {
        // A limit must not change while the vine is bent.
        refuse(0, RefusalReason::kRegulating);
    } else {
        const Settings before = settings_;
        if (!set(set_setting.id, Real(set_setting.value))) {
            refuse(0, RefusalReason::kOutOfRange);
            return;
        }
        // Store only changes: writing wears the memory out. After damage, any value stores all.
        const bool changed = before.at(set_setting.id) != settings_.at(set_setting.id);
        if (changed || settings_memory_ != SettingsMemory::kStored) settings_changed_ = true;
        // Another host may have changed it. Whoever commands must first read the new digest in a `Welcome`.
        if (changed) settings_told_ = false;
        tell_setting(set_setting.id);
    }
}

void Firmware::refuse(uint16_t number, RefusalReason reason) { send(Refusal{number, reason}); }

void Firmware::tell_setting(uint8_t id) {
    const SettingRow* row = setting_row(id);
    if (row == nullptr) {
        refuse(0, RefusalReason::kOutOfRange);
        return;
    }
    send(SettingValue{id, kSettingCount, row->name, static_cast<float>(settings_.at(id)),
                      static_cast<float>(row->least), static_cast<float>(row->most),
                      static_cast<float>(row->standard)});
}

void Firmware::tell_telemetry(const Drive& told) {
    telemetry_us_ += telemetry_period_us_;
    // After a pause, do not catch up in a burst.
    if (static_cast<int32_t>(now_us_ - telemetry_us_) >= 0) telemetry_us_ = now_us_ + telemetry_period_us_;
    Telemetry telemetry;
    telemetry.device_time_ms = time_ms_;
    telemetry.mode = mode();
    telemetry.faults = latched_;
    telemetry.number = number_;
    telemetry.setpoint_kPa = regulating_ ? static_cast<float>(regulator_.setpoint_kPa()) : 0.0f;
    telemetry.cv_kPa = static_cast<float>(cv_kPa_);
    telemetry.reservoir_kPa = static_cast<float>(reservoir_kPa_);
    telemetry.evp_opening = duty(told.evp, Real(1));
    telemetry.dvp_opening = duty(told.dvp, Real(1));
    telemetry.solenoid = told.solenoid;
    send(telemetry);
}

Real Firmware::setpoint_most_kPa() const {
    return settings_[SettingId::kCvLimit_kPa] - settings_[SettingId::kSetpointMargin_kPa];
}

}  // namespace phlosar

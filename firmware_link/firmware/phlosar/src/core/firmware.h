// The phloSAR's firmware without its board. Inputs: bytes, readings, time. Outputs: bytes, duty cycles.
//
// It has its own limits, dead-man and latched faults, which no message can switch off. No clock, no port, no heap.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "framing.h"
#include "messages.h"
#include "output_queue.h"
#include "real.h"
#include "regulator.h"
#include "sensors.h"
#include "settings.h"
#include "valves.h"

namespace phlosar {

// The data with which the board starts.
struct Boot {
    // Differs after every reset.
    uint32_t boot_id;
    bool by_watchdog;
    // Content of the settings' memory: bytes from `unsaved`, erased bytes, or damaged bytes.
    const uint8_t* stored;
    size_t stored_size;
};

class Firmware {
public:
    // `build` is printable, has at most kBuildSize characters, and outlives this object.
    explicit Firmware(const char* build) : build_(build) {}

    // Call it once, before anything else. The vine is vented until a host commands a setpoint.
    void start(const Boot& boot);

    // Executes messages of the host at once, with the time of the last step. Before the first step bytes are lost.
    void receive(const uint8_t* data, size_t size);

    // Call it once a millisecond. `now_us` never goes back, and wraps.
    Outputs step(uint32_t now_us, const Readings& readings);

    // As `step`, with pressures instead of readings, and openings instead of duty cycles.
    Drive control(uint32_t now_us, const Pressures& pressures);

    // Takes up to `size` bytes that are to be sent to the host.
    size_t take_output(uint8_t* into, size_t size) { return output_.take(into, size); }
    size_t output_size() const { return output_.size(); }

    // True once after a change of the settings: `image` then has the Settings::kImageSize bytes to store.
    // Storing may take time, so call it only while venting.
    bool unsaved(uint8_t* image);

    // Changes a setting without storing it. False if the value is out of range.
    bool set(uint8_t id, Real value);

    Mode mode() const;
    uint16_t faults() const { return latched_; }
    // Number of the last accepted setpoint or vent; 0 before the first.
    uint16_t number() const { return number_; }
    const Settings& settings() const { return settings_; }
    // Time since the first step; wraps after 49 days.
    uint32_t time_ms() const { return time_ms_; }

private:
    // Maximum steps of relief by the Venturi. With a wrong sensor, more would empty the reservoir and collapse the
    // vine.
    static constexpr uint16_t kMostRelief = 1000;
    // One step of relief is regained in so many steps without a latched over-pressure: all in a minute.
    static constexpr uint16_t kReliefRegain = 60;

    // A Venturi whose exhaust is blocked blows its supply into the vine: while it runs, the pressure has risen by so
    // much.
    static constexpr Real kBlowsBack_kPa = Real(3.0);
    // So many steps after an over-pressure the valves have followed: air that still flows in is not the Venturi's.
    static constexpr uint16_t kReliefSettles = 60;
    // The rise counts from a pressure that a single wrong reading moves by 1 kPa only.
    static constexpr Real kSteadyMost_kPa = Real(8.0);
    static constexpr Real kSteadyFilter = Real(0.125);
    // For so many steps after a supply below the least one the Venturi stays off. Switched on and off by the noise
    // of a supply near it, the Venturi would raise the vine a little each time.
    static constexpr uint16_t kLowSupply = 100;

    // A condition that counts if three of the last sixteen readings show it. One wrong reading does not end a
    // flight, and a contact that flickers does not hide its fault behind good readings.
    class Frequent {
    public:
        void see(bool now) { seen_ = static_cast<uint16_t>(seen_ << 1 | (now ? 1 : 0)); }
        bool there() const {
            const uint32_t without_one = without_lowest(seen_);
            return without_lowest(without_one) != 0;
        }

    private:
        static uint32_t without_lowest(uint32_t bits) { return bits & (bits - 1); }

        // The last readings, one bit each.
        uint16_t seen_ = 0;
    };

    void configure();
    void look(const Pressures& pressures);
    void latch(uint16_t faults);
    void handle(const HostMessage& message);
    void on_hello(const Hello& hello);
    void on_setpoint(const Setpoint& setpoint);
    void on_set_setting(const SetSetting& set_setting);
    // False if there is no reason.
    bool why_refused(const Setpoint& setpoint, RefusalReason* reason) const;
    void refuse(uint16_t number, RefusalReason reason);
    void tell_setting(uint8_t id);
    void tell_telemetry(const Drive& told);
    void follow_clock(uint32_t now_us);
    Real relief();
    bool blows_back(bool venturi_runs);
    bool of_this_session(const Setpoint& setpoint) const { return greeted_ && settings_told_ && setpoint.session == session_; }
    bool repeated(const Setpoint& setpoint);
    void accept(uint16_t number);
    // True if a newer command was accepted before: the line may reorder frames.
    bool overtaken(uint16_t number) const;
    Real setpoint_most_kPa() const;

    template <typename Message>
    void send(const Message& message) {
        uint8_t payload[kMaxMessage];
        const size_t size = write(message, sequence_++, payload);
        output_.put_frame(payload, size);
    }

    const char* build_;
    Settings settings_;
    SettingsMemory settings_memory_ = SettingsMemory::kErased;
    bool settings_changed_ = false;
    Regulator regulator_;
    Sensor cv_sensor_{};
    Sensor reservoir_sensor_{};
    uint32_t telemetry_period_us_ = 0;
    FrameDecoder frames_;
    OutputQueue output_;
    uint8_t sequence_ = 0;

    uint32_t boot_id_ = 0;
    bool stepped_ = false;
    bool greeted_ = false;
    uint32_t greetings_ = 0;
    uint32_t session_ = 0;
    // No setting has changed since the last `Welcome`.
    bool settings_told_ = false;
    // Of the newest setpoint since the handshake.
    uint32_t setpoint_count_ = 0;
    bool regulating_ = false;
    uint16_t latched_ = kNoFault;
    uint16_t present_ = kNoFault;
    uint16_t number_ = 0;
    // Newest number since the handshake; valid if `counting_`.
    uint16_t newest_ = 0;
    bool counting_ = false;

    Real target_kPa_ = 0;
    Real most_per_step_kPa_ = 0;
    uint32_t commanded_us_ = 0;
    uint32_t holds_us_ = 0;

    Real cv_kPa_ = 0;
    Real reservoir_kPa_ = 0;
    Frequent bad_cv_;
    Frequent bad_reservoir_;
    Frequent bad_supply_;
    Frequent high_cv_;
    Frequent high_reservoir_;
    // The last reading of the vine is valid and above the limit.
    bool above_limit_ = false;
    // Steps of relief that are not yet regained.
    uint16_t relief_steps_ = 0;
    uint16_t regained_steps_ = 0;
    // Steps for which the Venturi stays off, and the filtered pressure from which its rise counts.
    uint16_t low_supply_steps_ = 0;
    Real steady_cv_kPa_ = 0;
    // Since the Venturi was last off: its steps, the vine's lowest pressure, and whether it has risen from there.
    uint16_t venturi_steps_ = 0;
    Real venturi_lowest_kPa_ = 0;
    Frequent venturi_raises_;

    uint32_t now_us_ = 0;
    uint32_t telemetry_us_ = 0;
    uint32_t time_ms_ = 0;
    // Start of the present millisecond.
    uint32_t millisecond_us_ = 0;
};

}  // namespace phlosar

// The phloSAR's firmware without its board: bytes, readings and the time come in, bytes and duty cycles go out.
//
// No message and no loss leaves the safe state's decisions to the host: limits, dead-man and latched faults are
// decided here. No clock, no port, no heap.
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

// What is known when the board starts.
struct Boot {
    // Differs after every reset.
    uint32_t boot_id;
    bool by_watchdog;
    // What `unsaved` once gave, or whatever the memory holds.
    const uint8_t* stored;
    size_t stored_size;
};

class Firmware {
public:
    // Printable, at most kBuildSize characters; must outlive this.
    explicit Firmware(const char* build) : build_(build) {}

    // Once, before anything else. The valves are safe until a host commands otherwise.
    void start(const Boot& boot);

    // Bytes from the host, acted upon at once, as of the last step's time; lost before the first step.
    void receive(const uint8_t* data, size_t size);

    // Once a millisecond. `now_us` never goes back, and wraps.
    Outputs step(uint32_t now_us, const Readings& readings);

    // The same between sensors and valves: openings from pressures.
    Drive control(uint32_t now_us, const Pressures& pressures);

    // What is to be sent to the host, up to `size` bytes, once.
    size_t take_output(uint8_t* into, size_t size) { return output_.take(into, size); }
    size_t output_size() const { return output_.size(); }

    // Settings that were changed and are to be kept over power cycles: Settings::kImageSize bytes, once.
    // False while there are none. Keeping may take time: ask only while venting.
    bool unsaved(uint8_t* image);

    // As SetSetting, from a board's own knowledge.
    bool set(uint8_t id, Real value);

    Mode mode() const;
    uint16_t faults() const { return latched_; }
    // Of the last setpoint or vent accepted; 0 before the first.
    uint16_t number() const { return number_; }
    const Settings& settings() const { return settings_; }
    // Since the first step; wraps after 49 days.
    uint32_t time_ms() const { return time_ms_; }

private:
    // So many bad readings in a row count: a glitch does not end a flight, and 3 ms are soon enough.
    static constexpr uint8_t kInARow = 3;

    // A sensor that lies would else empty the bottle, and suck the vine flat.
    static constexpr uint16_t kMostRelief = 1000;

    // A condition that counts once it was there so many times in a row.
    class Lasting {
    public:
        void see(bool now) {
            count_ = now ? static_cast<uint8_t>(count_ < kInARow ? count_ + 1 : kInARow) : 0;
        }
        bool there() const { return count_ == kInARow; }

    private:
        uint8_t count_ = 0;
    };

    void configure();
    void look(const Pressures& pressures);
    void latch(uint16_t faults);
    void handle(const HostMessage& message);
    void on_hello(const Hello& hello);
    void on_setpoint(const Setpoint& setpoint);
    void on_set_setting(const SetSetting& set_setting);
    // No reason: false.
    bool why_refused(const Setpoint& setpoint, RefusalReason* reason) const;
    void refuse(uint16_t number, RefusalReason reason);
    void tell_setting(uint8_t id);
    void tell_telemetry(const Drive& told);
    void follow_clock(uint32_t now_us);
    Real relief();
    void accept(uint16_t number);
    // Whether a newer command came before it: a line may deliver in another order.
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
    bool regulating_ = false;
    uint16_t latched_ = kNoFault;
    uint16_t present_ = kNoFault;
    uint16_t number_ = 0;
    // Of the commands since the handshake, once there was one.
    uint16_t newest_ = 0;
    bool counting_ = false;

    Real target_kPa_ = 0;
    Real most_per_step_kPa_ = 0;
    uint32_t commanded_us_ = 0;
    uint32_t holds_us_ = 0;

    Real cv_kPa_ = 0;
    Real reservoir_kPa_ = 0;
    Lasting bad_cv_;
    Lasting bad_reservoir_;
    Lasting bad_supply_;
    Lasting high_cv_;
    Lasting high_reservoir_;
    uint16_t relief_steps_ = 0;

    uint32_t now_us_ = 0;
    uint32_t telemetry_us_ = 0;
    uint32_t time_ms_ = 0;
    // When the last of these began.
    uint32_t millisecond_us_ = 0;
};

}  // namespace phlosar

// The messages between host and firmware, as in docs/serial-protocol.md. The host's side is in
// firmware_link/protocol.py.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace phlosar {

constexpr uint8_t kProtocolVersion = 3;

enum class Mode : uint8_t { kVent = 0, kRegulate = 1, kFault = 2 };

// Each bit latches until it is cleared.
enum Fault : uint16_t {
    kNoFault = 0,
    kDeadMan = 1 << 0,
    kCvOverpressure = 1 << 1,
    kReservoirOverpressure = 1 << 2,
    kCvSensor = 1 << 3,
    kReservoirSensor = 1 << 4,
    kWatchdogReset = 1 << 5,
    kSettings = 1 << 6,
    kSupply = 1 << 7,
    kVenturi = 1 << 8,
};

enum class RefusalReason : uint8_t {
    kNoHandshake = 1,
    kVersion = 2,
    kOutOfRange = 3,
    kFaultLatched = 4,
    kNotANumber = 5,
    kRegulating = 6,
    kOvertaken = 7,
};

// What was in the memory of the settings.
enum class SettingsMemory : uint8_t { kStored = 1, kErased = 2, kDamaged = 3 };

// From the host.

struct Hello {
    uint8_t protocol_version;
    uint32_t nonce;
};

struct Setpoint {
    float target_kPa;
    float rate_kPa_per_s;
    uint16_t ttl_ms;
    uint16_t number;
    // From the `Welcome` of this session.
    uint32_t session;
    // Differs for each setpoint that the host sends in a session, repeats too, and only grows.
    uint32_t count;
};

struct Vent {
    uint16_t number;
};

struct ClearFaults {
    uint16_t mask;
};

struct Ping {
    uint64_t host_time_us;
};

struct GetSetting {
    uint8_t id;
};

struct SetSetting {
    uint8_t id;
    float value;
};

struct HostMessage {
    enum class Type : uint8_t {
        kNone = 0,
        kHello = 0x01,
        kSetpoint = 0x02,
        kVent = 0x03,
        kClearFaults = 0x04,
        kPing = 0x05,
        kGetSetting = 0x06,
        kSetSetting = 0x07,
    };
    Type type;
    union {
        Hello hello;
        Setpoint setpoint;
        Vent vent;
        ClearFaults clear_faults;
        Ping ping;
        GetSetting get_setting;
        SetSetting set_setting;
    };
};

// kNone if the payload is not a message of a host.
HostMessage parse(const uint8_t* payload, size_t size);

// To the host.

constexpr size_t kBuildSize = 16;
constexpr size_t kSettingNameSize = 24;

struct Welcome {
    uint32_t nonce;
    uint32_t boot_id;
    const char* firmware_build;
    float cv_limit_kPa;
    float setpoint_limit_kPa;
    float reservoir_limit_kPa;
    float rate_limit_kPa_per_s;
    uint16_t dead_man_ms;
    uint16_t telemetry_Hz;
    uint32_t session;
    uint32_t settings_digest;
    SettingsMemory settings_memory;
};

struct Telemetry {
    uint32_t device_time_ms;
    Mode mode;
    uint16_t faults;
    uint16_t number;
    float setpoint_kPa;
    float cv_kPa;
    float reservoir_kPa;
    uint16_t evp_opening;  // of 65535
    uint16_t dvp_opening;
    bool solenoid;
};

struct Refusal {
    uint16_t number;
    RefusalReason reason;
};

struct Pong {
    uint64_t host_time_us;
    uint32_t device_time_ms;
};

struct SettingValue {
    uint8_t id;
    uint8_t count;
    const char* name;
    float value;
    float least;
    float most;
    float standard;
};

constexpr size_t kMaxMessage = 60;

// Each writes a payload of at most kMaxMessage bytes and returns its size.
size_t write(const Welcome& message, uint8_t sequence, uint8_t* payload);
size_t write(const Telemetry& message, uint8_t sequence, uint8_t* payload);
size_t write(const Refusal& message, uint8_t sequence, uint8_t* payload);
size_t write(const Pong& message, uint8_t sequence, uint8_t* payload);
size_t write(const SettingValue& message, uint8_t sequence, uint8_t* payload);

}  // namespace phlosar

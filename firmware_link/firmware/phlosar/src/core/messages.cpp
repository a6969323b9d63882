#include "messages.h"

#include "bytes.h"

namespace phlosar {

namespace {

constexpr size_t kHeaderSize = 2;
constexpr uint8_t kUnitsKPaGauge = 1;
// SetSetting ends with it. A corrupted frame that passes its CRC by chance does not have it.
constexpr uint16_t kUnlock = 0x5E77;

enum DeviceType : uint8_t {
    kWelcome = 0x81,
    kTelemetry = 0x82,
    kRefusal = 0x83,
    kPong = 0x84,
    kSetting = 0x85,
};

Writer begin(DeviceType type, uint8_t sequence, uint8_t* payload) {
    Writer writer(payload);
    writer.u8(type);
    writer.u8(sequence);
    return writer;
}

}  // namespace

HostMessage parse(const uint8_t* payload, size_t size) {
    using Type = HostMessage::Type;
    HostMessage message;
    message.type = Type::kNone;
    if (size < kHeaderSize) return message;
    const size_t body = size - kHeaderSize;
    Reader reader(payload + kHeaderSize);
    switch (static_cast<Type>(payload[0])) {
        case Type::kHello:
            if (body != 5) break;
            message.type = Type::kHello;
            message.hello.protocol_version = reader.u8();
            message.hello.nonce = reader.u32();
            break;
        case Type::kSetpoint:
            if (body != 20) break;
            message.type = Type::kSetpoint;
            message.setpoint.target_kPa = reader.f32();
            message.setpoint.rate_kPa_per_s = reader.f32();
            message.setpoint.ttl_ms = reader.u16();
            message.setpoint.number = reader.u16();
            message.setpoint.session = reader.u32();
            message.setpoint.count = reader.u32();
            break;
        case Type::kVent:
            if (body != 2) break;
            message.type = Type::kVent;
            message.vent.number = reader.u16();
            break;
        case Type::kClearFaults:
            if (body != 2) break;
            message.type = Type::kClearFaults;
            message.clear_faults.mask = reader.u16();
            break;
        case Type::kPing:
            if (body != 8) break;
            message.type = Type::kPing;
            message.ping.host_time_us = reader.u64();
            break;
        case Type::kGetSetting:
            if (body != 1) break;
            message.type = Type::kGetSetting;
            message.get_setting.id = reader.u8();
            break;
        case Type::kSetSetting:
            if (body != 7) break;
            message.set_setting.id = reader.u8();
            message.set_setting.value = reader.f32();
            if (reader.u16() == kUnlock) message.type = Type::kSetSetting;
            break;
        case Type::kNone:
        default:
            break;
    }
    return message;
}

size_t write(const Welcome& message, uint8_t sequence, uint8_t* payload) {
    Writer writer = begin(kWelcome, sequence, payload);
    writer.u8(kProtocolVersion);
    writer.u32(message.nonce);
    writer.u32(message.boot_id);
    writer.text(message.firmware_build, kBuildSize);
    writer.u8(kUnitsKPaGauge);
    writer.f32(message.cv_limit_kPa);
    writer.f32(message.setpoint_limit_kPa);
    writer.f32(message.reservoir_limit_kPa);
    writer.f32(message.rate_limit_kPa_per_s);
    writer.u16(message.dead_man_ms);
    writer.u16(message.telemetry_Hz);
    writer.u32(message.session);
    writer.u32(message.settings_digest);
    writer.u8(static_cast<uint8_t>(message.settings_memory));
    return writer.size();
}

size_t write(const Telemetry& message, uint8_t sequence, uint8_t* payload) {
    Writer writer = begin(kTelemetry, sequence, payload);
    writer.u32(message.device_time_ms);
    writer.u8(static_cast<uint8_t>(message.mode));
    writer.u16(message.faults);
    writer.u16(message.number);
    writer.f32(message.setpoint_kPa);
    writer.f32(message.cv_kPa);
    writer.f32(message.reservoir_kPa);
    writer.u16(message.evp_opening);
    writer.u16(message.dvp_opening);
    writer.u8(message.solenoid ? 1 : 0);
    return writer.size();
}

size_t write(const Refusal& message, uint8_t sequence, uint8_t* payload) {
    Writer writer = begin(kRefusal, sequence, payload);
    writer.u16(message.number);
    writer.u8(static_cast<uint8_t>(message.reason));
    return writer.size();
}

size_t write(const Pong& message, uint8_t sequence, uint8_t* payload) {
    Writer writer = begin(kPong, sequence, payload);
    writer.u64(message.host_time_us);
    writer.u32(message.device_time_ms);
    return writer.size();
}

size_t write(const SettingValue& message, uint8_t sequence, uint8_t* payload) {
    Writer writer = begin(kSetting, sequence, payload);
    writer.u8(message.id);
    writer.u8(message.count);
    writer.text(message.name, kSettingNameSize);
    writer.f32(message.value);
    writer.f32(message.least);
    writer.f32(message.most);
    writer.f32(message.standard);
    return writer.size();
}

}  // namespace phlosar

// Gives the firmware's core any bytes, readings and times, and checks what must always hold.
//
// An input is a program for one board: bytes of a line, whole frames, readings, steps of any length, a port that
// takes any number of bytes, power cycles. Runs under libFuzzer or driver.cpp, with sanitizers. So every buffer
// has exactly its stated size.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../phlosar/src/core/firmware.h"

using namespace phlosar;

namespace {

uint64_t bytes_received = 0;
uint64_t steps_made = 0;
uint64_t steps_regulating = 0;

#define HOLDS(what) \
    do { \
        if (!(what)) fail(#what, __LINE__); \
    } while (false)

[[noreturn]] void fail(const char* what, int line) {
    fprintf(stderr, "core.cpp:%d: does not hold: %s\n", line, what);
    abort();
}

void tell_counts() {
    printf("received %llu bytes, made %llu steps, %llu of them regulating\n",
           static_cast<unsigned long long>(bytes_received), static_cast<unsigned long long>(steps_made),
           static_cast<unsigned long long>(steps_regulating));
}

// The input, consumed from its front; zeros when it is used up.
class Input {
public:
    Input(const uint8_t* data, size_t size) : data_(data), size_(size) {}

    bool empty() const { return size_ == 0; }
    uint8_t u8() {
        if (size_ == 0) return 0;
        --size_;
        return *data_++;
    }
    uint16_t u16() { return static_cast<uint16_t>(u8() << 8 | u8()); }
    uint32_t u32() { return static_cast<uint32_t>(u16()) << 16 | u16(); }
    float f32() {
        const uint32_t bits = u32();
        float value;
        memcpy(&value, &bits, sizeof value);
        return value;
    }

private:
    const uint8_t* data_;
    size_t size_;
};

// Memory of exactly this size, so that a sanitizer finds any access beyond it.
class Bytes {
public:
    explicit Bytes(size_t size) : at_(static_cast<uint8_t*>(malloc(size))), size_(size) {}
    Bytes(Input& input, size_t size) : Bytes(size) {
        for (size_t i = 0; i < size; ++i) at_[i] = input.u8();
    }
    ~Bytes() { free(at_); }
    Bytes(const Bytes&) = delete;
    Bytes& operator=(const Bytes&) = delete;

    uint8_t* at() { return at_; }
    size_t size() const { return size_; }

private:
    uint8_t* at_;
    size_t size_;
};

class Board {
public:
    Board(Input& input, uint32_t now_us, const uint8_t* stored, size_t stored_size) : now_us_(now_us) {
        firmware_.start(Boot{input.u32(), input.u8() % 2 == 1, stored, stored_size});
        damaged_ = (firmware_.faults() & kSettings) != 0;
        check_settings();
    }

    uint32_t now_us() const { return now_us_; }
    uint32_t session() const { return session_; }
    uint32_t count() const { return count_; }

    void receive(Bytes& bytes) {
        bytes_received += bytes.size();
        firmware_.receive(bytes.at(), bytes.size());
        if (stepped_) overhear(bytes);
        if ((firmware_.faults() & kCvOverpressure) == 0) helped_ = 0;
        check();
    }

    void step(const Readings& readings, uint32_t after_us) {
        now_us_ += after_us;
        const Outputs told = firmware_.step(now_us_, readings);
        after_step(pressures(cv_sensor(), reservoir_sensor(), readings));
        const auto most = [this](SettingId full_duty) {
            return static_cast<double>(firmware_.settings()[full_duty]) * 65535.0 + 0.5;
        };
        HOLDS(told.evp_duty <= most(SettingId::kEvpFullDuty));
        HOLDS(told.dvp_duty <= most(SettingId::kDvpFullDuty));
        if (firmware_.mode() != Mode::kRegulate) {
            HOLDS(told.evp_duty == 0 && (told.dvp_duty == 0 || may_help()) && told.solenoid);
        }
    }

    void control(const Pressures& seen, uint32_t after_us) {
        now_us_ += after_us;
        const Drive told = firmware_.control(now_us_, seen);
        after_step(seen);
        HOLDS(told.evp >= Real(0) && told.evp <= Real(1));
        HOLDS(told.dvp >= Real(0) && told.dvp <= Real(1));
        if (firmware_.mode() != Mode::kRegulate) {
            HOLDS(told.evp == Real(0) && (told.dvp == Real(0) || may_help()) && told.solenoid);
        }
    }

    void take_output(size_t most) {
        Bytes bytes(most);
        const size_t before = firmware_.output_size();
        const size_t count = firmware_.take_output(bytes.at(), most);
        HOLDS(count == (most < before ? most : before));
        HOLDS(firmware_.output_size() == before - count);
        for (size_t i = 0; i < count; ++i) hear(bytes.at()[i]);
    }

    bool unsaved(Bytes& image) {
        const bool unsaved = firmware_.unsaved(image.at());
        if (unsaved) damaged_ = false;
        return unsaved;
    }

private:
    static constexpr uint32_t kLongestDeadMan_us = 300000;
    static constexpr size_t kMostOutput = 1024;
    static constexpr int kConditions = 5;
    static constexpr unsigned kSeen = 16;

    Sensor cv_sensor() const {
        const Settings& settings = firmware_.settings();
        return sensor(settings[SettingId::kCvSpan_kPa], settings[SettingId::kCvZero_kPa]);
    }

    Sensor reservoir_sensor() const {
        const Settings& settings = firmware_.settings();
        return sensor(settings[SettingId::kReservoirSpan_kPa], settings[SettingId::kReservoirZero_kPa]);
    }

    // While the board does not regulate, the Venturi may run only after an over-pressure, for a second.
    bool may_help() {
        HOLDS(++helped_ <= 1000);
        return (firmware_.faults() & kCvOverpressure) != 0;
    }

    // Follows what the host sends.
    void overhear(Bytes& bytes) {
        for (size_t i = 0; i < bytes.size(); ++i) {
            if (!line_.push(bytes.at()[i])) continue;
            Bytes payload(line_.size());
            memcpy(payload.at(), line_.payload(), payload.size());
            const HostMessage message = parse(payload.at(), payload.size());
            if (message.type == HostMessage::Type::kHello) {
                greeted_ = message.hello.protocol_version == kProtocolVersion;
                commanded_ = false;
                welcomed_ = false;
                count_ = 0;
            } else if (message.type == HostMessage::Type::kSetpoint) {
                // A repeated setpoint, or one of an earlier session, must not prolong anything.
                const bool fresh = message.setpoint.session == session_ && message.setpoint.count > count_;
                if (welcomed_ && !fresh) continue;
                count_ = message.setpoint.count;
                commanded_ = true;
                commanded_us_ = now_us_;
            } else if (message.type == HostMessage::Type::kVent) {
                commanded_ = false;
            }
        }
    }

    void after_step(const Pressures& seen) {
        stepped_ = true;
        ++steps_made;
        const Settings& settings = firmware_.settings();
        const bool cv_good = cv_sensor().can_say(seen.cv_kPa);
        const bool reservoir_good = reservoir_sensor().can_say(seen.reservoir_kPa);
        struct {
            bool told;
            bool wrong;
        } const conditions[kConditions] = {
            {true, !seen.supply_good},
            {true, !cv_good},
            {true, !reservoir_good},
            // An invalid reading does not count for a limit.
            {cv_good, seen.cv_kPa > settings[SettingId::kCvLimit_kPa]},
            {reservoir_good, seen.reservoir_kPa > settings[SettingId::kReservoirLimit_kPa]},
        };
        const bool regulating = firmware_.mode() == Mode::kRegulate;
        for (int i = 0; i < kConditions; ++i) {
            if (conditions[i].told) note(i, conditions[i].wrong);
            HOLDS(!regulating || wrong(i) < 3);
        }
        if (regulating) {
            ++steps_regulating;
            HOLDS(now_us_ - commanded_us_ < kLongestDeadMan_us);
        }
        check();
    }

    void note(int condition, bool wrong) { seen_[condition][noted_[condition]++ % kSeen] = wrong; }

    // How many of the last readings were wrong.
    int wrong(int condition) const {
        int count = 0;
        for (const bool wrong : seen_[condition]) count += wrong ? 1 : 0;
        return count;
    }

    void check() {
        HOLDS(firmware_.output_size() <= kMostOutput);
        if (firmware_.mode() == Mode::kRegulate) {
            HOLDS(firmware_.faults() == kNoFault);
            HOLDS(stepped_ && greeted_ && commanded_);
        }
        // No message clears the fault of damaged settings before settings are stored.
        HOLDS(!damaged_ || (firmware_.faults() & kSettings) != 0);
        HOLDS((firmware_.mode() == Mode::kFault) == (firmware_.faults() != kNoFault));
        check_settings();
    }

    void check_settings() const {
        for (uint8_t id = 0; id < kSettingCount; ++id) {
            const Real value = firmware_.settings().at(id);
            HOLDS(value >= setting_row(id)->least && value <= setting_row(id)->most);
        }
    }

    // The host receives whole frames only, even if frames were lost between them.
    void hear(uint8_t byte) {
        const bool good = host_.push(byte);
        if (byte != 0) return;
        HOLDS(good && host_.size() >= 2 && host_.size() <= kMaxMessage);
        const uint8_t* payload = host_.payload();
        HOLDS(payload[0] >= 0x81 && payload[0] <= 0x85);
        if (payload[0] == 0x81) {
            uint32_t session;
            memcpy(&session, payload + 48, sizeof session);
            HOLDS(session != session_);
            session_ = session;
            welcomed_ = true;
        }
        if (payload[0] != 0x82) return;
        for (size_t at = 11; at < 23; at += 4) {
            float number;
            memcpy(&number, payload + at, sizeof number);
            HOLDS(isfinite(number));
        }
        if (payload[6] == static_cast<uint8_t>(Mode::kRegulate)) return;
        const uint8_t shut_and_vented[] = {0, 0, 0, 0, 1};
        const uint8_t helped[] = {0, 0, 0xFF, 0xFF, 1};
        const bool over_the_limit = (payload[7] & kCvOverpressure) != 0;
        HOLDS(memcmp(payload + 23, shut_and_vented, sizeof shut_and_vented) == 0 ||
              (over_the_limit && memcmp(payload + 23, helped, sizeof helped) == 0));
    }

    Firmware firmware_{"fuzz"};
    FrameDecoder line_;
    FrameDecoder host_;
    uint32_t now_us_;
    uint32_t commanded_us_ = 0;
    unsigned helped_ = 0;
    // Of the last Welcome that the host has read.
    uint32_t session_ = 0;
    bool welcomed_ = false;
    bool damaged_ = false;
    // Newest setpoint since the last Hello.
    uint32_t count_ = 0;
    bool stepped_ = false;
    bool greeted_ = false;
    bool commanded_ = false;
    // The last readings, true if wrong: of the supply, of each sensor, above each limit.
    bool seen_[kConditions][kSeen] = {};
    unsigned noted_[kConditions] = {};
};

void send(Board& board, const uint8_t* payload, size_t size) {
    OutputQueue queue;
    queue.put_frame(payload, size);
    Bytes bytes(queue.size());
    queue.take(bytes.at(), bytes.size());
    board.receive(bytes);
}

constexpr size_t kBodySizes[] = {0, 5, 20, 2, 2, 8, 1, 7, 3};

// Sends a message of type 0 to 8, with the right length or one byte more or less.
void send_message(Input& input, Board& board) {
    const uint8_t kind = input.u8();
    const uint8_t type = kind % 9;
    const size_t whole = kBodySizes[type];
    const size_t body = kind >= 0xF0 ? whole + 1 : kind >= 0xE0 && whole > 0 ? whole - 1 : whole;
    uint8_t payload[2 + 21] = {type, input.u8()};
    for (size_t i = 0; i < body; ++i) payload[2 + i] = input.u8();
    send(board, payload, 2 + body);
}

// Sends messages like a host: a greeting, a clearing of all faults, and a setpoint that is valid in most cases, or
// has come before.
void send_command(Input& input, Board& board) {
    const uint8_t hello[] = {1, 0, kProtocolVersion, 1, 2, 3, 4};
    const uint8_t clear[] = {4, 1, 0xFF, 0xFF};
    uint8_t setpoint[22] = {2, 2, 0, 0, 0, 0, 0, 0, 0, 0, input.u8(), input.u8(), 1, 0};
    const uint8_t how = input.u8();
    const bool odd = how >= 0xF0;
    const float target_kPa = odd ? input.f32() : static_cast<float>(input.u8()) / 10.0f;
    const float rate_kPa_per_s = odd ? input.f32() : static_cast<float>(input.u16()) / 100.0f;
    memcpy(setpoint + 2, &target_kPa, sizeof target_kPa);
    memcpy(setpoint + 6, &rate_kPa_per_s, sizeof rate_kPa_per_s);
    if (how % 4 == 0) {
        // Room for the answer, with the session.
        board.take_output(2048);
        send(board, hello, sizeof hello);
        board.take_output(2048);
    }
    if (how % 4 <= 1) send(board, clear, sizeof clear);
    const bool repeats = how / 4 % 2 == 1;
    const uint32_t session = board.session();
    const uint32_t count = board.count() + (repeats ? 0 : 1);
    memcpy(setpoint + 14, &session, sizeof session);
    memcpy(setpoint + 18, &count, sizeof count);
    send(board, setpoint, sizeof setpoint);
}

// Changes a setting, mostly within its range.
void send_setting(Input& input, Board& board) {
    const uint8_t id = input.u8() % kSettingCount;
    const SettingRow* row = setting_row(id);
    const uint8_t share = input.u8();
    const Real value = row->least + (row->most - row->least) * Real(share) / Real(0xE0);
    uint8_t payload[] = {7, 0, id, 0, 0, 0, 0, 0x77, 0x5E};
    const float on_wire = share < 0xF0 ? static_cast<float>(value) : input.f32();
    memcpy(payload + 3, &on_wire, sizeof on_wire);
    send(board, payload, sizeof payload);
}

// Up to half of the clock's range. After a longer pause the clock would seem to go back; the watchdog resets the
// board before that.
uint32_t pause_us(Input& input) {
    const uint8_t kind = input.u8();
    if (kind < 0xC0) return 1000;
    if (kind < 0xF0) return input.u16();
    return kind < 0xFF ? 64u * input.u16() : input.u32() >> 1;
}

// Readings of a rig that is mostly healthy.
Readings usual_readings(Input& input) {
    const auto counts = [&input](unsigned per_unit) {
        return static_cast<uint16_t>(5958 + per_unit * input.u8());
    };
    const uint16_t cv = counts(32);
    return {cv, counts(100), 59578};
}

void live(Input& input) {
    Bytes memory(input, input.u8() % 2 == 1 ? Settings::kImageSize + input.u8() % 3 : input.u8() % 2);
    const uint32_t first_us = input.u8() % 2 == 1 ? 0u - input.u16() : input.u32();
    Board* board = new Board(input, first_us, memory.at(), memory.size());
    while (!input.empty()) {
        switch (input.u8() % 12) {
            case 0: {
                Bytes bytes(input, input.u8());
                board->receive(bytes);
                break;
            }
            case 1:
                send_message(input, *board);
                break;
            case 2:
                send_command(input, *board);
                break;
            case 3:
                send_setting(input, *board);
                break;
            case 4: {
                Bytes payload(input, input.u8() % (kMaxPayload + 1));
                send(*board, payload.at(), payload.size());
                parse(payload.at(), payload.size());
                break;
            }
            case 5:
                board->step({input.u16(), input.u16(), input.u16()}, pause_us(input));
                break;
            case 6:
            case 7: {
                const Readings readings = usual_readings(input);
                board->step(readings, pause_us(input));
                for (int more = input.u8(); more > 0; --more) board->step(readings, 1000);
                break;
            }
            case 8: {
                const Pressures seen{Real(input.f32()), Real(input.f32()), input.u8() != 0};
                board->control(seen, pause_us(input));
                break;
            }
            case 9:
            case 10:
                board->take_output(input.u16() % 2048);
                break;
            case 11: {
                Bytes image(Settings::kImageSize);
                const bool changed = board->unsaved(image);
                const uint32_t now_us = board->now_us();
                delete board;
                board = new Board(input, now_us, image.at(), changed ? image.size() : 0);
                break;
            }
        }
    }
    delete board;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
    static const int told_at_exit = atexit(tell_counts);
    (void)told_at_exit;
    Input input(data, size);
    live(input);
    return 0;
}

// Number of bytes that all inputs so far have sent to the firmware.
extern "C" uint64_t phlosar_fuzz_bytes() { return bytes_received; }

// Endpoint 0 of a USB serial port (CDC, abstract control model): what a host asks, and what it is answered.
//
// Chapter 9 of the USB 2.0 specification and the requests of CDC 1.2's PSTN subclass, as a state machine:
// packets come in, packets go out, no register is touched. Who owns the hardware calls `setup`, `out` and
// `in_done` as packets come and go, and after each of them looks at `next_in`, `stalled`, `address`, and the
// endpoints.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace usb {

constexpr size_t kPacket = 64;
constexpr uint8_t kNotifyEndpoint = 1;
constexpr uint8_t kOutEndpoint = 2;
constexpr uint8_t kInEndpoint = 3;
constexpr uint8_t kLastEndpoint = 3;

struct InPacket {
    const uint8_t* data;
    size_t size;
    bool data1;
};

class Control {
public:
    // Told as a string of decimal digits.
    void set_serial_number(uint32_t number);

    // The bus was reset.
    void reset();
    void setup(const uint8_t* packet, size_t size);
    void out(const uint8_t* data, size_t size);
    // The host has taken the packet that `next_in` gave.
    void in_done();

    // The packet to be sent next, once. False when there is none.
    bool next_in(InPacket* packet);
    // The host is to be answered STALL, once.
    bool stalled() const { return stage_ == Stage::kStalled; }
    void stall_sent() {
        if (stalled()) stage_ = Stage::kIdle;
    }

    uint8_t address() const { return address_; }
    bool configured() const { return configured_; }
    // A program on the host holds the port open.
    bool port_open() const { return configured_ && (line_state_ & 1u) != 0; }
    bool halted(uint8_t endpoint) const { return (halted_ & 1u << endpoint) != 0; }
    // Whether this endpoint is to forget its packets and begin again at DATA0, once.
    bool take_restart(uint8_t endpoint);
    // A host set 134 baud, which no serial port has: that asks for the bootloader.
    bool bootloader_asked() const { return bootloader_asked_; }

private:
    enum class Stage : uint8_t { kIdle, kDataIn, kDataOut, kStatusIn, kStatusOut, kStalled };
    struct Setup {
        uint8_t type;
        uint8_t request;
        uint16_t value;
        uint16_t index;
        uint16_t length;
    };

    static constexpr size_t kLineCodingSize = 7;
    static constexpr size_t kMostString = 16;

    void device_request(const Setup& setup);
    void interface_request(const Setup& setup);
    void endpoint_request(const Setup& setup);
    void port_request(const Setup& setup);
    void send_descriptor(const Setup& setup);
    void send_text(const Setup& setup, const char* text);
    void send(const Setup& setup, const void* data, size_t size);
    void send_word(const Setup& setup, uint8_t low);
    bool accept(const Setup& setup);
    void send_status();
    void configure(bool configured);

    Stage stage_ = Stage::kIdle;
    uint8_t address_ = 0;
    uint8_t address_to_be_ = 0;
    bool configured_ = false;
    uint8_t halted_ = 0;
    uint8_t restarts_ = 0;
    uint8_t line_state_ = 0;
    bool bootloader_asked_ = false;
    uint8_t line_coding_[kLineCodingSize] = {0x00, 0xC2, 0x01, 0x00, 0, 0, 8};

    const uint8_t* sending_ = nullptr;
    size_t left_ = 0;
    bool in_pending_ = false;
    bool data1_ = false;
    uint8_t reply_[2 + 2 * kMostString] = {};
    char serial_number_[11] = "0";
};

}  // namespace usb

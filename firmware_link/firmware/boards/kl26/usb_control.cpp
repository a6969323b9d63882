#include "usb_control.h"

#include <string.h>

namespace usb {

namespace {

// bmRequestType.
constexpr uint8_t kToHost = 0x80;
constexpr uint8_t kTypeAndRecipient = 0x7F;
constexpr uint8_t kDevice = 0x00;
constexpr uint8_t kInterface = 0x01;
constexpr uint8_t kEndpoint = 0x02;
constexpr uint8_t kClassInterface = 0x21;

// bRequest of chapter 9, with the direction that each has.
constexpr uint8_t kGetStatus = 0;
constexpr uint8_t kClearFeature = 1;
constexpr uint8_t kSetFeature = 3;
constexpr uint8_t kSetAddress = 5;
constexpr uint8_t kGetDescriptor = 6;
constexpr uint8_t kGetConfiguration = 8;
constexpr uint8_t kSetConfiguration = 9;
constexpr uint8_t kGetInterface = 10;
constexpr uint8_t kSetInterface = 11;
// Of the communications class.
constexpr uint8_t kSetLineCoding = 0x20;
constexpr uint8_t kGetLineCoding = 0x21;
constexpr uint8_t kSetControlLineState = 0x22;

constexpr uint16_t kEndpointHalt = 0;
constexpr uint16_t kPortInterface = 0;
constexpr uint16_t kDataInterface = 1;
constexpr uint16_t kInterfaces = 2;
constexpr uint32_t kBootloaderBaud = 134;

constexpr uint8_t kDeviceDescriptor[] = {
    18, 1,       // size, DEVICE
    0x00, 0x02,  // USB 2.0
    2, 0, 0,     // communications, all else said by the interfaces
    kPacket,
    0xC0, 0x16,  // the vendor and product of Teensy's USB serial
    0x83, 0x04,  //
    0x00, 0x01,  // release 1.0
    1, 2, 3,     // strings: manufacturer, product, serial number
    1,           // one configuration
};

constexpr uint8_t kConfigurationDescriptor[] = {
    9, 2, 67, 0, kInterfaces, 1, 0, 0x80, 50,            // CONFIGURATION 1: powered by the bus, 100 mA
    9, 4, kPortInterface, 0, 1, 2, 2, 1, 0,              // INTERFACE: communications, abstract control
    5, 0x24, 0, 0x10, 0x01,                              // header: CDC 1.1
    5, 0x24, 1, 0x00, kDataInterface,                    // call management: none
    4, 0x24, 2, 0x02,                                    // abstract control: line coding and line state
    5, 0x24, 6, kPortInterface, kDataInterface,          // union
    7, 5, 0x80 | kNotifyEndpoint, 3, 16, 0, 64,          // ENDPOINT: interrupt, 16 bytes, each 64 ms
    9, 4, kDataInterface, 0, 2, 10, 0, 0, 0,             // INTERFACE: data
    7, 5, kOutEndpoint, 2, kPacket, 0, 0,                // ENDPOINT: bulk
    7, 5, 0x80 | kInEndpoint, 2, kPacket, 0, 0,          // ENDPOINT: bulk
};
static_assert(sizeof kDeviceDescriptor == 18, "as it says");
static_assert(sizeof kConfigurationDescriptor == 67, "as it says");
static_assert(sizeof kConfigurationDescriptor % kPacket != 0, "its end would take an empty packet");

constexpr uint8_t kLanguages[] = {4, 3, 0x09, 0x04};  // English (United States)

// The number of the endpoint that an index names, 0 when there is none but endpoint 0.
uint8_t data_endpoint(uint16_t index) {
    switch (index) {
        case 0x80 | kNotifyEndpoint:
            return kNotifyEndpoint;
        case kOutEndpoint:
            return kOutEndpoint;
        case 0x80 | kInEndpoint:
            return kInEndpoint;
        default:
            return 0;
    }
}

bool is_endpoint_0(uint16_t index) { return index == 0x00 || index == 0x80; }

constexpr uint8_t bit(uint8_t endpoint) { return static_cast<uint8_t>(1u << endpoint); }
constexpr uint8_t kAllEndpoints = bit(kNotifyEndpoint) | bit(kOutEndpoint) | bit(kInEndpoint);

}  // namespace

void Control::set_serial_number(uint32_t number) {
    char reversed[sizeof serial_number_];
    size_t size = 0;
    do {
        reversed[size++] = static_cast<char>('0' + number % 10);
        number /= 10;
    } while (number != 0);
    for (size_t i = 0; i < size; ++i) serial_number_[i] = reversed[size - 1 - i];
    serial_number_[size] = '\0';
}

void Control::reset() {
    stage_ = Stage::kIdle;
    address_ = address_to_be_ = 0;
    in_pending_ = false;
    configure(false);
}

void Control::setup(const uint8_t* packet, size_t size) {
    // Whatever was under way is over; what is not understood stays stalled.
    in_pending_ = false;
    data1_ = true;
    address_to_be_ = address_;
    stage_ = Stage::kStalled;
    if (size != 8) return;
    const Setup setup{packet[0], packet[1], static_cast<uint16_t>(packet[2] | packet[3] << 8),
                      static_cast<uint16_t>(packet[4] | packet[5] << 8),
                      static_cast<uint16_t>(packet[6] | packet[7] << 8)};
    switch (setup.type & kTypeAndRecipient) {
        case kDevice:
            device_request(setup);
            break;
        case kInterface:
            interface_request(setup);
            break;
        case kEndpoint:
            endpoint_request(setup);
            break;
        case kClassInterface:
            port_request(setup);
            break;
        default:
            break;
    }
}

void Control::out(const uint8_t* data, size_t size) {
    if (stage_ == Stage::kDataIn || stage_ == Stage::kStatusOut) {
        // The status stage, perhaps before all was taken.
        in_pending_ = false;
        stage_ = Stage::kIdle;
        return;
    }
    if (stage_ != Stage::kDataOut) return;
    if (size != kLineCodingSize) {
        stage_ = Stage::kStalled;
        return;
    }
    memcpy(line_coding_, data, kLineCodingSize);
    uint32_t baud = 0;
    for (size_t i = 4; i-- > 0;) baud = baud << 8 | line_coding_[i];
    if (baud == kBootloaderBaud) bootloader_asked_ = true;
    send_status();
}

void Control::in_done() {
    if (stage_ == Stage::kStatusIn) {
        address_ = address_to_be_;
        stage_ = Stage::kIdle;
    } else if (stage_ == Stage::kDataIn) {
        in_pending_ = left_ > 0;
        if (!in_pending_) stage_ = Stage::kStatusOut;
    }
}

bool Control::next_in(InPacket* packet) {
    if (!in_pending_) return false;
    in_pending_ = false;
    const size_t size = left_ < kPacket ? left_ : kPacket;
    *packet = {sending_, size, data1_};
    sending_ += size;
    left_ -= size;
    data1_ = !data1_;
    return true;
}

bool Control::take_restart(uint8_t endpoint) {
    const bool wanted = (restarts_ & bit(endpoint)) != 0;
    restarts_ = static_cast<uint8_t>(restarts_ & ~bit(endpoint));
    return wanted;
}

void Control::device_request(const Setup& setup) {
    switch (setup.type << 8 | setup.request) {
        case kToHost << 8 | kGetStatus:
            if (setup.value == 0 && setup.index == 0) send_word(setup, 0);
            break;
        case kSetAddress:
            if (setup.value > 127 || setup.index != 0 || configured_) break;
            if (accept(setup)) address_to_be_ = static_cast<uint8_t>(setup.value);
            break;
        case kToHost << 8 | kGetDescriptor:
            send_descriptor(setup);
            break;
        case kToHost << 8 | kGetConfiguration:
            reply_[0] = configured_ ? 1 : 0;
            if (setup.value == 0 && setup.index == 0) send(setup, reply_, 1);
            break;
        case kSetConfiguration:
            if (setup.value > 1 || setup.index != 0) break;
            if (accept(setup)) configure(setup.value == 1);
            break;
        default:
            break;
    }
}

void Control::interface_request(const Setup& setup) {
    if (!configured_ || setup.index >= kInterfaces) return;
    switch (setup.type << 8 | setup.request) {
        case (kToHost | kInterface) << 8 | kGetStatus:
            if (setup.value == 0) send_word(setup, 0);
            break;
        case (kToHost | kInterface) << 8 | kGetInterface:
            reply_[0] = 0;
            if (setup.value == 0) send(setup, reply_, 1);
            break;
        case kInterface << 8 | kSetInterface:
            if (setup.value == 0 && accept(setup) && setup.index == kDataInterface) {
                restarts_ = static_cast<uint8_t>(restarts_ | bit(kOutEndpoint) | bit(kInEndpoint));
            }
            break;
        default:
            break;
    }
}

void Control::endpoint_request(const Setup& setup) {
    const uint8_t endpoint = data_endpoint(setup.index);
    const bool there = is_endpoint_0(setup.index) || (configured_ && endpoint != 0);
    if (!there) return;
    switch (setup.type << 8 | setup.request) {
        case (kToHost | kEndpoint) << 8 | kGetStatus:
            if (setup.value == 0) send_word(setup, endpoint != 0 && halted(endpoint) ? 1 : 0);
            break;
        case kEndpoint << 8 | kClearFeature:
            if (setup.value != kEndpointHalt || !accept(setup) || endpoint == 0) break;
            halted_ = static_cast<uint8_t>(halted_ & ~bit(endpoint));
            restarts_ = static_cast<uint8_t>(restarts_ | bit(endpoint));
            break;
        case kEndpoint << 8 | kSetFeature:
            // Endpoint 0 needs no halt to be cleared: the next SETUP does it.
            if (setup.value != kEndpointHalt || endpoint == 0) break;
            if (accept(setup)) halted_ = static_cast<uint8_t>(halted_ | bit(endpoint));
            break;
        default:
            break;
    }
}

void Control::port_request(const Setup& setup) {
    if (!configured_ || setup.index != kPortInterface) return;
    switch (setup.type << 8 | setup.request) {
        case kClassInterface << 8 | kSetLineCoding:
            if (setup.value == 0 && setup.length == kLineCodingSize) stage_ = Stage::kDataOut;
            break;
        case (kToHost | kClassInterface) << 8 | kGetLineCoding:
            if (setup.value == 0) send(setup, line_coding_, kLineCodingSize);
            break;
        case kClassInterface << 8 | kSetControlLineState:
            if (accept(setup)) line_state_ = static_cast<uint8_t>(setup.value);
            break;
        default:
            break;
    }
}

void Control::send_descriptor(const Setup& setup) {
    switch (setup.value) {
        case 0x0100:
            if (setup.index == 0) send(setup, kDeviceDescriptor, sizeof kDeviceDescriptor);
            break;
        case 0x0200:
            if (setup.index == 0) send(setup, kConfigurationDescriptor, sizeof kConfigurationDescriptor);
            break;
        case 0x0300:
            send(setup, kLanguages, sizeof kLanguages);
            break;
        case 0x0301:
            send_text(setup, "Flying Vines");
            break;
        case 0x0302:
            send_text(setup, "phloSAR");
            break;
        case 0x0303:
            send_text(setup, serial_number_);
            break;
        default:
            break;
    }
}

// ASCII as the specification's UTF-16.
void Control::send_text(const Setup& setup, const char* text) {
    size_t size = 2;
    for (; *text != '\0' && size < sizeof reply_; ++text) {
        reply_[size++] = static_cast<uint8_t>(*text);
        reply_[size++] = 0;
    }
    reply_[0] = static_cast<uint8_t>(size);
    reply_[1] = 3;
    send(setup, reply_, size);
}

void Control::send(const Setup& setup, const void* data, size_t size) {
    if (accept(setup)) return;
    sending_ = static_cast<const uint8_t*>(data);
    left_ = size < setup.length ? size : setup.length;
    in_pending_ = true;
    stage_ = Stage::kDataIn;
}

void Control::send_word(const Setup& setup, uint8_t low) {
    reply_[0] = low;
    reply_[1] = 0;
    send(setup, reply_, 2);
}

// A request without data: its status is an empty packet. False, and nothing is said, when there is to be data.
bool Control::accept(const Setup& setup) {
    if (setup.length != 0) return false;
    send_status();
    return true;
}

void Control::send_status() {
    sending_ = reply_;
    left_ = 0;
    in_pending_ = true;
    stage_ = Stage::kStatusIn;
}

void Control::configure(bool configured) {
    configured_ = configured;
    halted_ = 0;
    line_state_ = 0;
    restarts_ = kAllEndpoints;
}

}  // namespace usb

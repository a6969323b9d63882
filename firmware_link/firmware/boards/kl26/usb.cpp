// Buffer descriptors and nothing else: what packets mean is usb_control.h's affair.
//
// The controller keeps two buffers for each direction of each endpoint and takes them in turns, even and odd.
// A buffer that is lent to it may be filled or sent at any time; it gives it back with an interrupt.

#include "usb.h"

#include "registers.h"
#include "ring.h"
#include "usb_control.h"

namespace kl26 {

namespace {

// A descriptor's first word.
constexpr uint32_t kOwnedByController = 1u << 7;
constexpr uint32_t kIsData1 = 1u << 6;
constexpr uint32_t kChecksToggle = 1u << 3;
constexpr uint32_t kTokenSetup = 0xD;
constexpr uint32_t token(uint32_t word) { return word >> 2 & 0xF; }
constexpr uint32_t count(uint32_t word) { return word >> 16 & 0x3FF; }

struct Descriptor {
    volatile uint32_t word;
    const volatile void* volatile address;
};

enum Direction : unsigned { kOut = 0, kIn = 1 };
constexpr unsigned kEndpoints = usb::kLastEndpoint + 1;
Descriptor table[kEndpoints * 4] __attribute__((section(".usb_table"), aligned(512)));

constexpr unsigned kTokensQueued = 4;

// A packet that is not full ends a transfer: the host's driver hands it on at once.
constexpr size_t kShortPacket = usb::kPacket - 1;

// One direction of an endpoint.
class Pipe {
public:
    constexpr Pipe(unsigned endpoint, Direction direction) : first_(endpoint << 2 | direction << 1) {}

    unsigned lent() const { return lent_; }
    // The buffer to be lent next: 0 or 1.
    unsigned next() const { return turn_ ^ (lent_ & 1u); }

    void lend(const volatile void* buffer, size_t size, bool data1) {
        Descriptor& descriptor = table[first_ | next()];
        descriptor.address = buffer;
        descriptor.word = kOwnedByController | kChecksToggle | (data1 ? kIsData1 : 0) | size << 16;
        ++lent_;
    }
    void lend_in_turn(const volatile void* buffer, size_t size) {
        lend(buffer, size, data1_);
        data1_ = !data1_;
    }
    // The controller gave one back. False when it has none: that is news of before a reset.
    bool given_back() {
        if (lent_ == 0) return false;
        turn_ ^= 1u;
        --lent_;
        return true;
    }
    // What is lent is taken back, and the next packet is DATA0. The controller's turn stays.
    void restart() {
        table[first_].word = 0;
        table[first_ | 1u].word = 0;
        lent_ = 0;
        data1_ = false;
    }
    // The controller begins at the even buffers again.
    void reset() {
        restart();
        turn_ = 0;
    }

private:
    unsigned first_;
    unsigned turn_ = 0;
    unsigned lent_ = 0;
    bool data1_ = false;
};

usb::Control control;
Pipe control_out{0, kOut};
Pipe control_in{0, kIn};
Pipe data_out{usb::kOutEndpoint, kOut};
Pipe data_in{usb::kInEndpoint, kIn};

uint8_t control_buffers[2][usb::kPacket] __attribute__((aligned(4)));
uint8_t out_buffers[2][usb::kPacket] __attribute__((aligned(4)));
uint8_t in_buffers[2][usb::kPacket] __attribute__((aligned(4)));

Ring<256> received;
Ring<256> to_send;

void enable_endpoint(unsigned number, uint8_t directions, bool is_halted) {
    usb0_endpoint(number).write(
        static_cast<uint8_t>(directions | EP_HANDSHAKE | (is_halted ? EP_STALL : uint8_t{0})));
}

// What a host sends after a SETUP begins with DATA1, and a SETUP is taken with any toggle.
void lend_control_out() {
    while (control_out.lent() < 2) control_out.lend(control_buffers[control_out.next()], usb::kPacket, true);
}

// Only what there is room for is asked of the host: it is told to wait by silence.
void lend_data_out() {
    while (data_out.lent() < 2 && received.room() >= usb::kPacket * (data_out.lent() + 1)) {
        data_out.lend_in_turn(out_buffers[data_out.next()], usb::kPacket);
    }
}

void send_data_in() {
    while (data_in.lent() < 2 && to_send.size() > 0) {
        uint8_t* buffer = in_buffers[data_in.next()];
        data_in.lend_in_turn(buffer, to_send.take(buffer, kShortPacket));
    }
}

// Makes the hardware what `control` says it is.
void follow_control() {
    usb::InPacket packet;
    if (control.next_in(&packet)) control_in.lend(packet.data, packet.size, packet.data1);
    enable_endpoint(0, EP_RX | EP_TX, control.stalled());
    USB0_ADDR.write(control.address());
    if (control.take_restart(usb::kInEndpoint)) data_in.restart();
    if (control.take_restart(usb::kOutEndpoint)) data_out.restart();
    if (!control.configured()) {
        for (unsigned number = 1; number < kEndpoints; ++number) usb0_endpoint(number).write(0);
        return;
    }
    // Nothing is ever lent to it, so a host that asks for notifications is told to wait.
    enable_endpoint(usb::kNotifyEndpoint, EP_CTL_DIS | EP_TX, control.halted(usb::kNotifyEndpoint));
    enable_endpoint(usb::kOutEndpoint, EP_CTL_DIS | EP_RX, control.halted(usb::kOutEndpoint));
    enable_endpoint(usb::kInEndpoint, EP_CTL_DIS | EP_TX, control.halted(usb::kInEndpoint));
    if (!control.port_open()) to_send.clear();
    lend_data_out();
}

void on_bus_reset() {
    USB0_CTL.write(CTL_USBENSOFEN | CTL_ODDRST);
    control.reset();
    control_out.reset();
    control_in.reset();
    data_out.reset();
    data_in.reset();
    received.clear();
    to_send.clear();
    lend_control_out();
    follow_control();
    for (unsigned i = 0; i < kTokensQueued; ++i) USB0_ISTAT.write(INT_TOKDNE);
    USB0_ERRSTAT.write(0xFF);
    USB0_ISTAT.write(0xFF);
    USB0_CTL.write(CTL_USBENSOFEN);
}

void on_control_token(const Descriptor& descriptor, unsigned buffer, bool in) {
    if (!(in ? control_in : control_out).given_back()) return;
    if (in) {
        control.in_done();
    } else if (token(descriptor.word) == kTokenSetup) {
        // An answer to what was asked before is not wanted any more.
        control_in.restart();
        control.setup(control_buffers[buffer], count(descriptor.word));
    } else {
        control.out(control_buffers[buffer], count(descriptor.word));
    }
    lend_control_out();
    follow_control();
    // The controller waits after each SETUP until it has been looked at.
    USB0_CTL.write(CTL_USBENSOFEN);
}

void on_token(uint8_t status) {
    const unsigned endpoint = status >> 4;
    const bool in = (status & STAT_TX) != 0;
    const unsigned buffer = (status & STAT_ODD) != 0 ? 1 : 0;
    const Descriptor& descriptor = table[endpoint << 2 | (in ? 2u : 0u) | buffer];
    if (endpoint == 0) {
        on_control_token(descriptor, buffer, in);
    } else if (endpoint == usb::kOutEndpoint && !in && data_out.given_back()) {
        received.put(out_buffers[buffer], count(descriptor.word));
        lend_data_out();
    } else if (endpoint == usb::kInEndpoint && in && data_in.given_back()) {
        send_data_in();
    }
}

}  // namespace

void begin_usb(uint32_t serial_number) {
    control.set_serial_number(serial_number);
    SIM_SCGC4.set(SCGC4_USBOTG);
    const uint32_t page = reinterpret_cast<uint32_t>(table);
    USB0_BDTPAGE1.write(static_cast<uint8_t>(page >> 8));
    USB0_BDTPAGE2.write(static_cast<uint8_t>(page >> 16));
    USB0_BDTPAGE3.write(static_cast<uint8_t>(page >> 24));
    for (Descriptor& descriptor : table) descriptor.word = 0;
    USB0_ISTAT.write(0xFF);
    USB0_ERRSTAT.write(0xFF);
    USB0_CTL.write(CTL_USBENSOFEN);
    USB0_USBCTRL.write(0);
    USB0_INTEN.write(INT_USBRST | INT_TOKDNE | INT_STALL | INT_ERROR);
    NVIC_ISER.write(1u << IRQ_USB);
    enable_interrupts();
    USB0_CONTROL.write(CONTROL_DPPULLUP);
}

size_t read_usb(uint8_t* into, size_t most) {
    const NoInterrupts alone;
    const size_t size = received.take(into, most);
    if (control.configured()) lend_data_out();
    return size;
}

size_t write_usb(const uint8_t* data, size_t size) {
    const NoInterrupts alone;
    if (!control.port_open()) return size;
    const size_t taken = to_send.put(data, size);
    send_data_in();
    return taken;
}

bool usb_bootloader_asked() { return control.bootloader_asked(); }

}  // namespace kl26

void usb_handler() {
    using namespace kl26;
    if (USB0_ISTAT.any(INT_USBRST)) {
        on_bus_reset();
        return;
    }
    while (USB0_ISTAT.any(INT_TOKDNE)) {
        on_token(USB0_STAT.read());
        // Shows the next of the tokens that were done.
        USB0_ISTAT.write(INT_TOKDNE);
    }
    if (USB0_ISTAT.any(INT_STALL)) {
        control.stall_sent();
        follow_control();
    }
    if (USB0_ISTAT.any(INT_ERROR)) USB0_ERRSTAT.write(0xFF);
    USB0_ISTAT.write(INT_STALL | INT_ERROR);
}

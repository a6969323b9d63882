// The control endpoint of the USB serial port, for a test in Python to be its host.

#include "../../firmware_link/firmware/boards/kl26/usb_control.h"

extern "C" {

usb::Control* usb_create(uint32_t serial_number) {
    usb::Control* control = new usb::Control;
    control->set_serial_number(serial_number);
    return control;
}
void usb_destroy(usb::Control* control) { delete control; }

void usb_reset(usb::Control* control) { control->reset(); }
void usb_setup(usb::Control* control, const uint8_t* packet, size_t size) { control->setup(packet, size); }
void usb_out(usb::Control* control, const uint8_t* data, size_t size) { control->out(data, size); }
void usb_in_done(usb::Control* control) { control->in_done(); }
void usb_stall_sent(usb::Control* control) { control->stall_sent(); }

// -1: there is none. Otherwise its size, and 256 more when it is DATA1.
int usb_next_in(usb::Control* control, uint8_t* into) {
    usb::InPacket packet;
    if (!control->next_in(&packet)) return -1;
    for (size_t i = 0; i < packet.size; ++i) into[i] = packet.data[i];
    return static_cast<int>(packet.size) + (packet.data1 ? 256 : 0);
}
bool usb_stalled(const usb::Control* control) { return control->stalled(); }
uint8_t usb_address(const usb::Control* control) { return control->address(); }
bool usb_configured(const usb::Control* control) { return control->configured(); }
bool usb_port_open(const usb::Control* control) { return control->port_open(); }
bool usb_halted(const usb::Control* control, uint8_t endpoint) { return control->halted(endpoint); }
bool usb_take_restart(usb::Control* control, uint8_t endpoint) { return control->take_restart(endpoint); }
bool usb_bootloader_asked(const usb::Control* control) { return control->bootloader_asked(); }

}  // extern "C"

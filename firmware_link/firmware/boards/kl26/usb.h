// The chip's USB controller as a serial port.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace kl26 {

void begin_usb(uint32_t serial_number);
// The number of bytes that were there, or that were taken. While no program holds the port open all are taken
// and none is sent: whoever opens it hears of before at most the two packets that were on their way.
size_t read_usb(uint8_t* into, size_t most);
size_t write_usb(const uint8_t* data, size_t size);
bool usb_bootloader_asked();

}  // namespace kl26

extern "C" void usb_handler();

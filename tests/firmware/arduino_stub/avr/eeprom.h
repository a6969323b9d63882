// See Arduino.h here.
#pragma once

#include <stdint.h>

extern "C" {
uint8_t eeprom_read_byte(const uint8_t* address);
void eeprom_write_byte(uint8_t* address, uint8_t value);
}

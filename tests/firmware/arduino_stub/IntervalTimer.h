// See Arduino.h here.
#pragma once

#include <stdint.h>

class IntervalTimer {
public:
    void priority(uint8_t level);
    bool begin(void (*function)(), unsigned period_us);
};

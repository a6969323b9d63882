// When control steps are due, and whether they come in time.
#pragma once

#include <stdint.h>

namespace phlosar {

class StepClock {
public:
    // The first step is due at once.
    void start(uint32_t now_us) { due_us_ = now_us; }

    // True when a step is to be made now. A step that was missed is left out: a burst that catches up would
    // tell the regulator of time that has not passed.
    bool due(uint32_t now_us) {
        const uint32_t late_us = now_us - due_us_;
        if (static_cast<int32_t>(late_us) < 0) return false;
        if (late_us >= kLate_us) {
            in_time_ = 0;
        } else if (in_time_ < kInARow) {
            ++in_time_;
        }
        due_us_ = late_us < kPeriod_us ? due_us_ + kPeriod_us : now_us + kPeriod_us;
        return true;
    }

    // Whether the last steps kept their time: a loop that is too slow has steps in time now and then.
    bool steady() const { return in_time_ == kInARow; }

private:
    static constexpr uint32_t kPeriod_us = 1000;
    static constexpr uint32_t kLate_us = 250;
    static constexpr uint8_t kInARow = 8;

    uint32_t due_us_ = 0;
    uint8_t in_time_ = 0;
};

}  // namespace phlosar

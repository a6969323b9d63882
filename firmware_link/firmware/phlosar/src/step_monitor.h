// Decides if the watchdog may be fed.
#pragma once

#include <stdint.h>

namespace phlosar {

class StepMonitor {
public:
    // Call it in each step. `loop_turned`: the main loop has run since the last step.
    void step(uint32_t now_us, bool loop_turned) {
        // Compare with a schedule, not with the last step. Otherwise a slightly slow board would not be found.
        due_us_ += kPeriod_us;
        const int32_t late_us = static_cast<int32_t>(now_us - due_us_);
        if (late_us >= kTolerance_us || late_us <= -kTolerance_us) {
            on_time_ = 0;
            due_us_ = now_us;
        } else if (on_time_ < kInARow) {
            ++on_time_;
        }
        if (loop_turned) {
            silent_steps_ = 0;
        } else if (silent_steps_ < kMaxSilentSteps) {
            ++silent_steps_;
        }
    }

    // True if the last steps came on time and the main loop is alive.
    bool healthy() const { return on_time_ == kInARow && silent_steps_ < kMaxSilentSteps; }

private:
    static constexpr uint32_t kPeriod_us = 1000;
    static constexpr int32_t kTolerance_us = 250;
    // More than one, because some steps are on time even on an overloaded board.
    static constexpr uint8_t kInARow = 8;
    static constexpr uint8_t kMaxSilentSteps = 100;

    uint32_t due_us_ = 0;
    uint8_t on_time_ = 0;
    uint8_t silent_steps_ = kMaxSilentSteps;
};

}  // namespace phlosar

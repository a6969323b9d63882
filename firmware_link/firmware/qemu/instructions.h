// Counts instructions by the emulator's clock.
//
// Under `qemu-system-arm -icount shift=8` each instruction takes 256 ns of the clock that SysTick counts, so ticks
// are proportional to instructions. Without that option ticks measure the time of the emulating machine.
#pragma once

#include <stdint.h>

namespace instructions {

inline volatile uint32_t* systick(uint32_t offset) {
    return reinterpret_cast<volatile uint32_t*>(0xE000E010u + offset);
}

constexpr uint32_t kTicks = 0x00FFFFFF;

inline void begin() {
    *systick(4) = kTicks;
    *systick(8) = 0;
    // On, by the processor's clock, no interrupt.
    *systick(0) = 0b101;
}

// Ticks that `what` took.
template <typename What>
uint32_t ticks(const What& what) {
    const uint32_t before = *systick(8);
    asm volatile("" ::: "memory");
    what();
    asm volatile("" ::: "memory");
    return (before - *systick(8)) & kTicks;
}

}  // namespace instructions

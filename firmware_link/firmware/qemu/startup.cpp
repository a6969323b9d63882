// Runs before `main`: vectors, initial values of variables, and a handler that ends the program after a crash.

#include <stddef.h>
#include <stdint.h>

#include "semihosting.h"

int main();

extern "C" {

extern uint32_t stack_top[];
extern const uint32_t data_kept_at[];
extern uint32_t data_begin[];
extern uint32_t data_end[];
extern uint32_t bss_begin[];
extern uint32_t bss_end[];

[[noreturn]] void reset() {
#if defined(__ARM_FP)
    *reinterpret_cast<volatile uint32_t*>(0xE000ED88) = 0x00F00000;  // the floating-point unit on
    asm volatile("dsb\nisb" ::: "memory");
#endif
    const uint32_t* kept = data_kept_at;
    for (uint32_t* at = data_begin; at != data_end; ++at) *at = *kept++;
    for (uint32_t* at = bss_begin; at != bss_end; ++at) *at = 0;
    host::leave(main());
}

[[noreturn]] void crashed() { host::leave(100); }

}  // extern "C"

namespace {

union Vector {
    uint32_t* stack;
    void (*handler)();
};

// No interrupt is enabled: only NMI and faults can occur.
__attribute__((section(".vectors"), used)) constexpr Vector kVectors[] = {
    {stack_top}, {.handler = reset}, {.handler = crashed}, {.handler = crashed},
    {.handler = crashed}, {.handler = crashed}, {.handler = crashed},
};

}  // namespace

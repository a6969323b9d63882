// Files of the machine that emulates this one, by ARM's semihosting.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

namespace host {

enum class Call : uint32_t { kOpen = 0x01, kClose = 0x02, kWrite = 0x05, kRead = 0x06, kExit = 0x20 };

inline int32_t call(Call what, const void* arguments) {
    register uint32_t r0 asm("r0") = static_cast<uint32_t>(what);
    register const void* r1 asm("r1") = arguments;
    asm volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return static_cast<int32_t>(r0);
}

[[noreturn]] inline void leave(int status) {
    constexpr uint32_t kApplicationExit = 0x20026;
    const uint32_t arguments[] = {kApplicationExit, static_cast<uint32_t>(status)};
    for (;;) call(Call::kExit, arguments);
}

class File {
public:
    enum class Mode : uint32_t { kRead = 1, kWrite = 5 };

    // A file in the emulator's working folder. If it cannot be opened, the program ends.
    File(const char* name, Mode mode) {
        const uint32_t arguments[] = {address(name), static_cast<uint32_t>(mode),
                                      static_cast<uint32_t>(strlen(name))};
        handle_ = call(Call::kOpen, arguments);
        if (handle_ < 0) leave(101);
    }
    File(const File&) = delete;
    File& operator=(const File&) = delete;
    ~File() {
        const uint32_t arguments[] = {static_cast<uint32_t>(handle_)};
        call(Call::kClose, arguments);
    }

    // Returns the number of bytes that were read.
    size_t read(void* into, size_t size) {
        const uint32_t arguments[] = {static_cast<uint32_t>(handle_), address(into), size};
        return size - static_cast<size_t>(call(Call::kRead, arguments));
    }

    void write(const void* data, size_t size) {
        const uint32_t arguments[] = {static_cast<uint32_t>(handle_), address(data), size};
        if (call(Call::kWrite, arguments) != 0) leave(102);
    }

private:
    static uint32_t address(const void* of) { return reinterpret_cast<uint32_t>(of); }

    int32_t handle_;
};

}  // namespace host

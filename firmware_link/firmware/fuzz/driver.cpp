// Random and mutated inputs for core.cpp: driver SEED BYTES, or one input again: driver 0 0 INPUT.
//
// It does not measure coverage. It keeps a pool of inputs, and makes new ones at random or from one or two of them.

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);
extern "C" uint64_t phlosar_fuzz_bytes();

namespace {

constexpr size_t kMostBytes = 4096;
constexpr unsigned kPool = 64;

struct Made {
    uint8_t bytes[kMostBytes];
    size_t size;
};

Made pool[kPool];

// xorshift64*: the same inputs from the same seed on every machine.
class Dice {
public:
    explicit Dice(uint64_t seed) : state_(seed * 0x9E3779B97F4A7C15u + 1) {}
    uint64_t next() {
        state_ ^= state_ >> 12;
        state_ ^= state_ << 25;
        state_ ^= state_ >> 27;
        return (state_ * 0x2545F4914F6CDD1Du) >> 16;
    }
    size_t below(size_t most) { return static_cast<size_t>(next() % most); }

private:
    uint64_t state_;
};

void fill(Made& made, Dice& dice) {
    made.size = 1 + dice.below(kMostBytes);
    for (size_t i = 0; i < made.size; ++i) made.bytes[i] = static_cast<uint8_t>(dice.next());
}

void mutate(Made& made, Dice& dice) {
    const Made& other = pool[dice.below(kPool)];
    for (size_t times = 1 + dice.below(8); times > 0; --times) {
        const size_t at = dice.below(made.size);
        const size_t most = made.size - at;
        switch (dice.below(6)) {
            case 0:
                made.bytes[at] ^= static_cast<uint8_t>(1u << dice.below(8));
                break;
            case 1:
                made.bytes[at] = static_cast<uint8_t>(dice.next());
                break;
            case 2:  // a byte deleted
                if (made.size > 1) memmove(made.bytes + at, made.bytes + at + 1, most - 1), --made.size;
                break;
            case 3: {  // a piece repeated
                const size_t from = dice.below(made.size);
                const size_t left = made.size - from;
                memmove(made.bytes + at, made.bytes + from, most < left ? most : left);
                break;
            }
            case 4:  // cut off
                made.size = at + 1;
                break;
            default: {  // a piece of another input
                const size_t from = dice.below(other.size);
                const size_t room = kMostBytes - at;
                const size_t left = other.size - from;
                const size_t count = 1 + dice.below(room < left ? room : left);
                memmove(made.bytes + at, other.bytes + from, count);
                if (made.size < at + count) made.size = at + count;
            }
        }
    }
}

// Prints in libFuzzer's format. getrusage would include the memory of the program that started this one.
bool tell_peak_memory() {
    FILE* status = fopen("/proc/self/status", "r");
    if (status == nullptr) return false;
    char line[256];
    unsigned long kB = 0;
    while (kB == 0 && fgets(line, sizeof line, status) != nullptr) sscanf(line, "VmHWM: %lu kB", &kB);
    fclose(status);
    printf("peak_rss_mb: %lu\n", kB / 1024);
    return kB > 0;
}

int replay(const char* path) {
    FILE* file = fopen(path, "rb");
    if (file == nullptr) {
        fprintf(stderr, "driver: cannot read %s\n", path);
        return 2;
    }
    static Made made;
    made.size = fread(made.bytes, 1, sizeof made.bytes, file);
    fclose(file);
    return LLVMFuzzerTestOneInput(made.bytes, made.size);
}

}  // namespace

int main(int argc, char** argv) {
    if (argc < 3) {
        fprintf(stderr, "driver SEED BYTES, or driver 0 0 INPUT\n");
        return 2;
    }
    if (argc > 3) return replay(argv[3]);
    Dice dice(strtoull(argv[1], nullptr, 10));
    const uint64_t enough = strtoull(argv[2], nullptr, 10);
    for (Made& made : pool) fill(made, dice);
    while (phlosar_fuzz_bytes() < enough) {
        Made& made = pool[dice.below(kPool)];
        if (dice.below(4) == 0) {
            fill(made, dice);
        } else {
            mutate(made, dice);
        }
        LLVMFuzzerTestOneInput(made.bytes, made.size);
    }
    if (tell_peak_memory()) return 0;
    fprintf(stderr, "driver: /proc/self/status has no VmHWM\n");
    return 2;
}

// The firmware's core as a program: a phloSAR behind a pseudo-terminal, in real time, for any host.
//
// Its plant is the paper's: isothermal, with flows in proportion to the pressure difference. It shows how a
// vine fills and vents. For effects of real rigs use `flying-vines fake phlosar`.

#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <limits.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "../phlosar/src/board/board.h"
#include "../phlosar/src/core/firmware.h"

using namespace phlosar;

namespace {

const char kUsage[] =
    "phlosar-pty: the phloSAR's firmware behind a pseudo-terminal, in real time.\n"
    "\n"
    "  --link PATH          a stable name for the port; an existing link is replaced\n"
    "  --cv-kPa P           the vine's sensor always reads this (gauge)\n"
    "  --reservoir-kPa P    the reservoir's sensor always reads this (gauge)\n"
    "                       default: simulated, 2 L at 690 kPa and a vine of 0.5 L\n"
    "  --boot-id N          0 to 4294967295; default: a new one at each start\n"
    "  --settings FILE      stores the settings; created when a host changes one. Without it: the standard ones\n";

constexpr char kBuild[] = PHLOSAR_VERSION " pty";
constexpr int kBadUsage = 2;
constexpr uint32_t kStep_us = 1000;
// This program may wake late. It makes up for missed steps up to this time; after a longer stall it skips them.
constexpr uint64_t kMaxBehind_us = 500000;
constexpr size_t kChunk = 64;

// 5 V behind a divider of 0.6, read by a converter of 3.3 V.
constexpr double kSupplyCounts = 59578.0;

volatile sig_atomic_t stopped = 0;

[[noreturn]] void give_up(int status, const char* what, const char* where, const char* why) {
    fprintf(stderr, "phlosar-pty: %s%s%s%s%s\n", what, *where ? " " : "", where, *why ? ": " : "", why);
    exit(status);
}

struct Options {
    const char* link = nullptr;
    const char* settings = nullptr;
    double cv_kPa = NAN;
    double reservoir_kPa = NAN;
    uint32_t boot_id = 0;
};

double pressure(const char* option, const char* text) {
    char* end = nullptr;
    const double kPa = strtod(text, &end);
    if (end == text || *end != '\0' || !isfinite(kPa)) give_up(kBadUsage, option, text, "is not a pressure");
    return kPa;
}

uint32_t boot_id_from(const char* text) {
    char* end = nullptr;
    errno = 0;
    const unsigned long long id = strtoull(text, &end, 10);
    if (end == text || *end != '\0' || *text == '-' || errno != 0 || id > UINT32_MAX) {
        give_up(kBadUsage, "--boot-id", text, "is not within 0 to 4294967295");
    }
    return static_cast<uint32_t>(id);
}

uint64_t now_us() {
    timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return static_cast<uint64_t>(now.tv_sec) * 1000000 + static_cast<uint64_t>(now.tv_nsec) / 1000;
}

Options options_from(int argc, char** argv) {
    Options options;
    options.boot_id = static_cast<uint32_t>(time(nullptr)) * 2654435761u ^ static_cast<uint32_t>(getpid());
    const option known[] = {
        {"link", required_argument, nullptr, 'l'},     {"cv-kPa", required_argument, nullptr, 'c'},
        {"reservoir-kPa", required_argument, nullptr, 'r'}, {"boot-id", required_argument, nullptr, 'b'},
        {"settings", required_argument, nullptr, 's'}, {"help", no_argument, nullptr, 'h'},
        {nullptr, 0, nullptr, 0},
    };
    for (int found; (found = getopt_long(argc, argv, "", known, nullptr)) != -1;) {
        switch (found) {
            case 'l':
                options.link = optarg;
                break;
            case 'c':
                options.cv_kPa = pressure("--cv-kPa", optarg);
                break;
            case 'r':
                options.reservoir_kPa = pressure("--reservoir-kPa", optarg);
                break;
            case 'b':
                options.boot_id = boot_id_from(optarg);
                break;
            case 's':
                options.settings = optarg;
                break;
            case 'h':
                fputs(kUsage, stdout);
                exit(0);
            default:
                fputs(kUsage, stderr);
                exit(kBadUsage);
        }
    }
    if (optind < argc) give_up(kBadUsage, argv[optind], "is not an option; see --help", "");
    return options;
}

// Reservoir and vine, and their sensors.
class Plant {
public:
    Plant(const Options& options, const Settings& settings)
        : cv_always_kPa_(options.cv_kPa),
          reservoir_always_kPa_(options.reservoir_kPa),
          full_evp_(duty(1, settings[SettingId::kEvpFullDuty])),
          full_dvp_(duty(1, settings[SettingId::kDvpFullDuty])) {}

    // Advances the gauge pressures by `kStep_us`.
    void step(const Outputs& outputs) {
        const double evp = outputs.evp_duty / full_evp_;
        const double dvp = outputs.dvp_duty / full_dvp_;
        const double in = evp * fmax(0.0, reservoir_kPa_ - cv_kPa_) / kEvp_kPa_s_per_SL;
        const double supply = dvp * reservoir_kPa_ / kDvp_kPa_s_per_SL;
        const double vacuum_kPa = dvp * kFullVacuum_kPa * fmin(1.0, reservoir_kPa_ / kRatedSupply_kPa);
        const double out = outputs.solenoid ? (cv_kPa_ + vacuum_kPa) / kSolenoid_kPa_s_per_SL : 0.0;
        const double step_s = kStep_us * 1e-6;
        reservoir_kPa_ -= (in + supply) * step_s * kStandard_kPa / kReservoir_L;
        cv_kPa_ += (in - out) * step_s * kStandard_kPa / kVine_L;
    }

    Readings read() const {
        const double cv_kPa = isnan(cv_always_kPa_) ? cv_kPa_ : cv_always_kPa_;
        const double reservoir_kPa = isnan(reservoir_always_kPa_) ? reservoir_kPa_ : reservoir_always_kPa_;
        return {counts(cv_kPa, kCvSpan_kPa), counts(reservoir_kPa, kReservoirSpan_kPa),
                static_cast<uint16_t>(kSupplyCounts)};
    }

private:
    // The paper's rig and sensors.
    static constexpr double kReservoir_L = 2.0;
    static constexpr double kVine_L = 0.5;
    static constexpr double kEvp_kPa_s_per_SL = 2042.0;
    static constexpr double kDvp_kPa_s_per_SL = 618.0;
    static constexpr double kSolenoid_kPa_s_per_SL = 70.0;
    static constexpr double kFullVacuum_kPa = 55.0;
    static constexpr double kRatedSupply_kPa = 600.0;
    static constexpr double kStandard_kPa = 101.325;
    static constexpr double kCvSpan_kPa = 206.84;
    static constexpr double kReservoirSpan_kPa = 1500.0;

    static uint16_t counts(double kPa, double span_kPa) {
        const double share = 0.1 + 0.8 * kPa / span_kPa;
        return static_cast<uint16_t>(lround(fmin(65535.0, fmax(0.0, share * kSupplyCounts))));
    }

    double cv_always_kPa_;
    double reservoir_always_kPa_;
    // Duty cycles that open the valves fully. A host that changes the settings does not change the valves.
    double full_evp_;
    double full_dvp_;
    double cv_kPa_ = 0.0;
    double reservoir_kPa_ = 690.0;
};

// Our end of a pseudo-terminal. The host's end stays open here, too, so the port survives a host that leaves.
class Port {
public:
    Port() {
        own_end_ = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
        const bool ready = own_end_ >= 0 && grantpt(own_end_) == 0 && unlockpt(own_end_) == 0;
        const char* path = ready ? ptsname(own_end_) : nullptr;
        host_end_ = path != nullptr ? open(path, O_RDWR | O_NOCTTY) : -1;
        termios raw;
        if (host_end_ < 0 || tcgetattr(host_end_, &raw) != 0) {
            give_up(1, "cannot open a pseudo-terminal", "", strerror(errno));
        }
        cfmakeraw(&raw);
        tcsetattr(host_end_, TCSANOW, &raw);
        snprintf(path_, sizeof path_, "%s", path);
    }

    const char* path() const { return path_; }

    void link_as(const char* link) const {
        struct stat there;
        if (lstat(link, &there) == 0) {
            if (!S_ISLNK(there.st_mode)) give_up(kBadUsage, link, "is not a link and is not replaced", "");
            unlink(link);
        }
        if (symlink(path_, link) != 0) give_up(kBadUsage, "cannot make the link", link, strerror(errno));
    }

    // Does nothing if the link is now another program's.
    void remove_link(const char* link) const {
        char to[PATH_MAX];
        const ssize_t size = readlink(link, to, sizeof to - 1);
        if (size < 0) return;
        to[size] = '\0';
        if (strcmp(to, path_) == 0) unlink(link);
    }

    void exchange(Firmware& firmware) {
        uint8_t incoming[kChunk];
        for (ssize_t size; (size = read(own_end_, incoming, sizeof incoming)) > 0;) {
            firmware.receive(incoming, static_cast<size_t>(size));
        }
        // If the terminal is full, bytes wait here, and then in the firmware, which drops whole frames.
        while (true) {
            if (sent_ == size_) {
                size_ = firmware.take_output(outgoing_, sizeof outgoing_);
                sent_ = 0;
            }
            const ssize_t taken = size_ > 0 ? write(own_end_, outgoing_ + sent_, size_ - sent_) : 0;
            if (taken <= 0) return;
            sent_ += static_cast<size_t>(taken);
        }
    }

    // Returns early if there is something to read.
    void wait(uint64_t for_us) const {
        pollfd reading{own_end_, POLLIN, 0};
        const timespec most{0, static_cast<long>(for_us) * 1000};
        ppoll(&reading, 1, &most, nullptr);
    }

private:
    int own_end_;
    int host_end_;
    char path_[PATH_MAX];
    uint8_t outgoing_[kChunk];
    size_t size_ = 0;
    size_t sent_ = 0;
};

// The settings in a file, in place of the chip's flash.
class Memory {
public:
    explicit Memory(const char* path) : path_(path) {
        Settings().write_image(image_);
        if (path == nullptr) return;
        FILE* file = fopen(path, "rb");
        if (file == nullptr && errno == ENOENT) return;
        if (file != nullptr) size_ = fread(image_, 1, sizeof image_, file);
        if (file == nullptr || ferror(file)) give_up(kBadUsage, "cannot read", path, strerror(errno));
        fclose(file);
    }

    const uint8_t* image() const { return image_; }
    size_t size() const { return size_; }

    // A crash leaves either the old or the new settings in the file.
    void store(Firmware& firmware) {
        if (!firmware.unsaved(image_) || path_ == nullptr) return;
        char fresh[PATH_MAX];
        if (snprintf(fresh, sizeof fresh, "%s.new", path_) >= static_cast<int>(sizeof fresh)) return;
        FILE* file = fopen(fresh, "wb");
        const bool written = file != nullptr && fwrite(image_, sizeof image_, 1, file) == 1;
        const bool closed = file != nullptr && fclose(file) == 0;
        if (!written || !closed || rename(fresh, path_) != 0) {
            fprintf(stderr, "phlosar-pty: cannot store the settings in %s: %s\n", path_, strerror(errno));
        }
    }

private:
    const char* path_;
    uint8_t image_[Settings::kImageSize];
    size_t size_ = sizeof image_;
};

void run(Firmware& firmware, Port& port, Memory& memory, Plant& plant) {
    uint64_t due_us = now_us();
    while (!stopped) {
        port.exchange(firmware);
        const uint64_t now = now_us();
        if (now < due_us) {
            port.wait(due_us - now);
            continue;
        }
        if (now - due_us > kMaxBehind_us) due_us = now;
        for (; due_us <= now; due_us += kStep_us) {
            plant.step(firmware.step(static_cast<uint32_t>(due_us), plant.read()));
        }
        if (firmware.mode() != Mode::kRegulate) memory.store(firmware);
    }
}

}  // namespace

int main(int argc, char** argv) {
    const Options options = options_from(argc, argv);
    struct sigaction stop{};
    stop.sa_handler = [](int) { stopped = 1; };
    sigaction(SIGINT, &stop, nullptr);
    sigaction(SIGTERM, &stop, nullptr);
    Memory memory(options.settings);
    Port port;
    if (options.link != nullptr) port.link_as(options.link);
    static Firmware firmware(kBuild);
    firmware.start(Boot{options.boot_id, false, memory.image(), memory.size()});
    Plant plant(options, firmware.settings());
    printf("%s\n", port.path());
    fflush(stdout);
    run(firmware, port, memory, plant);
    if (options.link != nullptr) port.remove_link(options.link);
    return 0;
}

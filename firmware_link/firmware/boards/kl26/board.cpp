// The board layer on the bare chip: registers, and none of anybody's libraries.

#include "../../phlosar/src/board/board.h"

#include "../../phlosar/src/board/pins.h"
#include "flash.h"
#include "pins.h"
#include "registers.h"
#include "usb.h"

namespace board {

namespace {

using namespace kl26;

constexpr uint32_t kTimer_Hz = 48000000;
constexpr uint32_t kBus_Hz = 24000000;
constexpr uint32_t kPwmPeriod = kTimer_Hz / kPwm_Hz;
constexpr uint32_t kCvChannel = 12;
constexpr uint32_t kReservoirChannel = 13;
constexpr uint32_t kSupplyChannel = 14;
static_assert(kCvPin == 19 && kReservoirPin == 18 && kSupplyPin == 15, "the pins of these channels");
static_assert(kEvpPin == 9 && kDvpPin == 10 && kSolenoidPin == 11 && kLightPin == 13, "the bits in pins.h");
static_assert(kConversions == 8, "SC3_8_CONVERSIONS");
// A host notices that a board went away for a reset only if it stays away.
constexpr uint32_t kAway_us = 20000;
constexpr uint32_t kAnswer_us = 15000;

void begin_clock() {
    SIM_SCGC6.set(SCGC6_PIT);
    PIT_MCR.write(0);
    PIT_LDVAL0.write(kBus_Hz / 1000000 - 1);
    PIT_LDVAL1.write(0xFFFFFFFF);
    PIT_TCTRL1.write(TCTRL_TEN | TCTRL_CHN);
    PIT_TCTRL0.write(TCTRL_TEN);
}

void begin_pwm() {
    SIM_SCGC6.set(SCGC6_TPM0);
    TPM0_SC.write(0);
    TPM0_MOD.write(kPwmPeriod - 1);
    tpm0_cv(kEvpChannel).write(0);
    tpm0_cv(kDvpChannel).write(0);
    tpm0_csc(kEvpChannel).write(CSC_MSB | CSC_ELSB);
    tpm0_csc(kDvpChannel).write(CSC_MSB | CSC_ELSB);
    TPM0_SC.write(SC_CMOD_INTERNAL);
    portc_pcr(kEvpBit).write(PCR_MUX_TPM);
    portc_pcr(kDvpBit).write(PCR_MUX_TPM);
}

uint16_t convert(uint32_t channel) {
    ADC0_SC1A.write(channel);
    while (!ADC0_SC1A.any(SC1_COCO)) {}
    return static_cast<uint16_t>(ADC0_RA.read());
}

void begin_converter() {
    SIM_SCGC5.set(SCGC5_PORTB | SCGC5_PORTC);
    SIM_SCGC6.set(SCGC6_ADC0);
    // Calibrated at 3 MHz and with the most averaging, as the manual wishes.
    ADC0_CFG1.write(CFG1_ADIV_8 | CFG1_16_BIT);
    ADC0_CFG2.write(0);
    ADC0_SC2.write(SC2_REFSEL_SUPPLY);
    ADC0_SC3.write(SC3_CAL | SC3_AVGE | SC3_32_CONVERSIONS);
    while (ADC0_SC3.any(SC3_CAL)) {}
    uint32_t sum = 0;
    for (unsigned i = 0; i < ADC0_CLP_COUNT; ++i) sum += adc0_clp(i).read();
    ADC0_PG.write((sum >> 1) | 0x8000u);
    ADC0_CFG1.write(CFG1_ADIV_2 | CFG1_16_BIT);
    ADC0_SC3.write(SC3_AVGE | SC3_8_CONVERSIONS);
}

uint32_t compare_value(uint16_t duty) { return (duty * kPwmPeriod + 0x7FFF) >> 16; }

}  // namespace

extern const char kBuild[] = PHLOSAR_VERSION " kl26";

void begin() {
    begin_clock();
    begin_pwm();
    begin_converter();
    const uint32_t number = serial_number();
    while (now_us() < kAway_us) {}
    begin_usb(number);
}

uint32_t now_us() { return ~PIT_CVAL1.read(); }

phlosar::Readings read() {
    phlosar::Readings readings;
    readings.cv = convert(kCvChannel);
    readings.reservoir = convert(kReservoirChannel);
    readings.supply = convert(kSupplyChannel);
    return readings;
}

void drive(const phlosar::Outputs& outputs) {
    tpm0_cv(kEvpChannel).write(compare_value(outputs.evp_duty));
    tpm0_cv(kDvpChannel).write(compare_value(outputs.dvp_duty));
    (outputs.solenoid ? GPIOC_PSOR : GPIOC_PCOR).write(1u << kSolenoidBit);
}

void light(bool on) { (on ? GPIOC_PSOR : GPIOC_PCOR).write(1u << kLightBit); }

size_t serial_read(uint8_t* into, size_t most) { return read_usb(into, most); }

size_t serial_write(const uint8_t* data, size_t size) { return write_usb(data, size); }

size_t load(uint8_t* into, size_t most) { return load_settings(into, most); }

void store(const uint8_t* data, size_t size) { store_settings(data, size); }

// The converter's noise, from the temperature sensor one conversion at a time: some bits in each of 64.
uint32_t boot_id() {
    ADC0_SC3.write(0);
    uint32_t hash = 2166136261u;
    for (unsigned i = 0; i < 64; ++i) hash = (hash ^ convert(ADC_CHANNEL_TEMPERATURE)) * 16777619u;
    ADC0_SC3.write(SC3_AVGE | SC3_8_CONVERSIONS);
    return hash;
}

bool reset_by_watchdog() { return RCM_SRS0.any(SRS0_WDOG) || RCM_SRS1.any(SRS1_LOCKUP); }

void feed_watchdog() {
    const NoInterrupts alone;
    SIM_SRVCOP.write(0x55);
    SIM_SRVCOP.write(0xAA);
}

bool bootloader_asked() { return usb_bootloader_asked(); }

// The board's second chip holds the processor by its debug port, and a breakpoint calls it. Before that the
// host's request is answered.
void enter_bootloader() {
    vent_valves();
    const uint32_t begin_us = now_us();
    while (now_us() - begin_us < kAnswer_us) {}
    __asm__ volatile("bkpt");
}

}  // namespace board

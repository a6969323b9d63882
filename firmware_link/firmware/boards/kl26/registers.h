// The registers of the MKL26Z64 that this firmware uses, by their names in NXP's reference manual.
#pragma once

#include <stdint.h>

namespace kl26 {

template <typename T>
class Register {
public:
    constexpr explicit Register(uint32_t address) : address_(address) {}

    T read() const { return *at(); }
    void write(T value) const { *at() = value; }
    void set(T bits) const { *at() = static_cast<T>(*at() | bits); }
    bool any(T bits) const { return (*at() & bits) != 0; }

private:
    volatile T* at() const { return reinterpret_cast<volatile T*>(address_); }

    uint32_t address_;
};

using Register8 = Register<uint8_t>;
using Register32 = Register<uint32_t>;

// System integration: clock gates, clock sources, watchdog, unique number.
constexpr Register32 SIM_SOPT2{0x40048004};
constexpr uint32_t SOPT2_TPMSRC_PLL = 1u << 24;
constexpr uint32_t SOPT2_USBSRC_PLL = 1u << 18;
constexpr uint32_t SOPT2_PLLFLLSEL_HALF_PLL = 1u << 16;
constexpr Register32 SIM_SCGC4{0x40048034};
constexpr uint32_t SCGC4_USBOTG = 1u << 18;
constexpr Register32 SIM_SCGC5{0x40048038};
constexpr uint32_t SCGC5_PORTB = 1u << 10;
constexpr uint32_t SCGC5_PORTC = 1u << 11;
constexpr Register32 SIM_SCGC6{0x4004803C};
constexpr uint32_t SCGC6_PIT = 1u << 23;
constexpr uint32_t SCGC6_TPM0 = 1u << 24;
constexpr uint32_t SCGC6_ADC0 = 1u << 27;
constexpr Register32 SIM_CLKDIV1{0x40048044};
constexpr Register32 SIM_UIDL{0x40048060};
// The watchdog ("COP"): the first write after a reset counts, and no other.
constexpr Register32 SIM_COPC{0x40048100};
constexpr uint32_t COPC_256_LPO_CYCLES = 2u << 2;
// 0x55 then 0xAA feeds it; anything else resets the chip at once.
constexpr Register32 SIM_SRVCOP{0x40048104};

// Why the chip was reset.
constexpr Register8 RCM_SRS0{0x4007F000};
constexpr uint8_t SRS0_WDOG = 1u << 5;
constexpr Register8 RCM_SRS1{0x4007F001};
constexpr uint8_t SRS1_LOCKUP = 1u << 1;

// The reset at low voltage. LVDRE can be written once.
constexpr Register8 PMC_LVDSC1{0x4007D000};
constexpr uint8_t LVDSC1_LVDRE = 1u << 4;
constexpr uint8_t LVDSC1_HIGH_TRIP = 1u << 0;

// Clock generator and oscillator.
constexpr Register8 MCG_C1{0x40064000};
constexpr uint8_t C1_CLKS_PLL = 0u << 6;
constexpr uint8_t C1_CLKS_EXTERNAL = 2u << 6;
constexpr uint8_t C1_FRDIV_512 = 4u << 3;
constexpr Register8 MCG_C2{0x40064001};
constexpr uint8_t C2_LOCRE0 = 1u << 7;
constexpr uint8_t C2_RANGE_VERY_HIGH = 2u << 4;
constexpr uint8_t C2_EREFS0 = 1u << 2;
constexpr Register8 MCG_C5{0x40064004};
constexpr uint8_t C5_PRDIV_4 = 3;
constexpr Register8 MCG_C6{0x40064005};
constexpr uint8_t C6_PLLS = 1u << 6;
constexpr uint8_t C6_CME0 = 1u << 5;
constexpr uint8_t C6_VDIV_24 = 0;
constexpr Register8 MCG_S{0x40064006};
constexpr uint8_t S_LOCK0 = 1u << 6;
constexpr uint8_t S_PLLST = 1u << 5;
constexpr uint8_t S_IREFST = 1u << 4;
constexpr uint8_t S_CLKST = 3u << 2;
constexpr uint8_t S_CLKST_EXTERNAL = 2u << 2;
constexpr uint8_t S_CLKST_PLL = 3u << 2;
constexpr uint8_t S_OSCINIT0 = 1u << 1;
constexpr Register8 OSC0_CR{0x40065000};
constexpr uint8_t OSC_ERCLKEN = 1u << 7;
constexpr uint8_t OSC_SC2P = 1u << 3;
constexpr uint8_t OSC_SC8P = 1u << 1;

// Pins.
constexpr Register32 portc_pcr(unsigned bit) { return Register32(0x4004B000 + 4 * bit); }
constexpr uint32_t PCR_MUX_GPIO = 1u << 8;
constexpr uint32_t PCR_MUX_TPM = 4u << 8;
constexpr Register32 GPIOC_PSOR{0x400FF084};
constexpr Register32 GPIOC_PCOR{0x400FF088};
constexpr Register32 GPIOC_PDDR{0x400FF094};

// Periodic timers: channel 1 counts what channel 0 counts down.
constexpr Register32 PIT_MCR{0x40037000};
constexpr Register32 PIT_LDVAL0{0x40037100};
constexpr Register32 PIT_TCTRL0{0x40037108};
constexpr Register32 PIT_LDVAL1{0x40037110};
constexpr Register32 PIT_CVAL1{0x40037114};
constexpr Register32 PIT_TCTRL1{0x40037118};
constexpr uint32_t TCTRL_TEN = 1u << 0;
constexpr uint32_t TCTRL_CHN = 1u << 2;

// The timer that makes the duty cycles.
constexpr Register32 TPM0_SC{0x40038000};
constexpr uint32_t SC_CMOD_INTERNAL = 1u << 3;
constexpr Register32 TPM0_MOD{0x40038008};
constexpr Register32 tpm0_csc(unsigned channel) { return Register32(0x4003800C + 8 * channel); }
constexpr Register32 tpm0_cv(unsigned channel) { return Register32(0x40038010 + 8 * channel); }
constexpr uint32_t CSC_MSB = 1u << 5;
constexpr uint32_t CSC_ELSB = 1u << 3;

// The converter.
constexpr Register32 ADC0_SC1A{0x4003B000};
constexpr uint32_t SC1_COCO = 1u << 7;
constexpr Register32 ADC0_CFG1{0x4003B008};
constexpr uint32_t CFG1_ADIV_2 = 1u << 5;
constexpr uint32_t CFG1_ADIV_8 = 3u << 5;
constexpr uint32_t CFG1_16_BIT = 3u << 2;
constexpr Register32 ADC0_CFG2{0x4003B00C};
constexpr Register32 ADC0_RA{0x4003B010};
constexpr Register32 ADC0_SC2{0x4003B020};
// VALTH: the chip's own supply. VREFH is the board's AREF pin, which may be open.
constexpr uint32_t SC2_REFSEL_SUPPLY = 1u << 0;
constexpr Register32 ADC0_SC3{0x4003B024};
constexpr uint32_t SC3_CAL = 1u << 7;
constexpr uint32_t SC3_AVGE = 1u << 2;
constexpr uint32_t SC3_8_CONVERSIONS = 1u << 0;
constexpr uint32_t SC3_32_CONVERSIONS = 3u << 0;
constexpr Register32 ADC0_PG{0x4003B02C};
// CLPS, CLP4, CLP3, CLP2, CLP1, CLP0.
constexpr Register32 adc0_clp(unsigned index) { return Register32(0x4003B038 + 4 * index); }
constexpr unsigned ADC0_CLP_COUNT = 6;
constexpr uint32_t ADC_CHANNEL_TEMPERATURE = 26;

// Flash. A command's bytes lie so that it and its address are one word.
constexpr Register8 FTFA_FSTAT{0x40020000};
constexpr uint8_t FSTAT_CCIF = 1u << 7;
constexpr uint8_t FSTAT_ERRORS = 7u << 4;
constexpr Register32 FTFA_FCCOB0123{0x40020004};
constexpr Register32 FTFA_FCCOB4567{0x40020008};
constexpr uint32_t COMMAND_PROGRAM_WORD = 0x06u << 24;
constexpr uint32_t COMMAND_ERASE_SECTOR = 0x09u << 24;
constexpr uint32_t COMMAND_READ_ONCE = 0x41u << 24;
// The flash's cache.
constexpr Register32 MCM_PLACR{0xF000300C};
constexpr uint32_t PLACR_CFCC = 1u << 10;

// USB, full speed.
constexpr Register8 USB0_ISTAT{0x40072080};
constexpr Register8 USB0_INTEN{0x40072084};
constexpr uint8_t INT_STALL = 1u << 7;
constexpr uint8_t INT_TOKDNE = 1u << 3;
constexpr uint8_t INT_ERROR = 1u << 1;
constexpr uint8_t INT_USBRST = 1u << 0;
constexpr Register8 USB0_ERRSTAT{0x40072088};
constexpr Register8 USB0_STAT{0x40072090};
constexpr uint8_t STAT_TX = 1u << 3;
constexpr uint8_t STAT_ODD = 1u << 2;
constexpr Register8 USB0_CTL{0x40072094};
constexpr uint8_t CTL_USBENSOFEN = 1u << 0;
constexpr uint8_t CTL_ODDRST = 1u << 1;
constexpr Register8 USB0_ADDR{0x40072098};
constexpr Register8 USB0_BDTPAGE1{0x4007209C};
constexpr Register8 USB0_BDTPAGE2{0x400720B0};
constexpr Register8 USB0_BDTPAGE3{0x400720B4};
constexpr Register8 usb0_endpoint(unsigned number) { return Register8(0x400720C0 + 4 * number); }
constexpr uint8_t EP_CTL_DIS = 1u << 4;
constexpr uint8_t EP_RX = 1u << 3;
constexpr uint8_t EP_TX = 1u << 2;
constexpr uint8_t EP_STALL = 1u << 1;
constexpr uint8_t EP_HANDSHAKE = 1u << 0;
constexpr Register8 USB0_USBCTRL{0x40072100};
constexpr Register8 USB0_CONTROL{0x40072108};
constexpr uint8_t CONTROL_DPPULLUP = 1u << 4;

// The processor's.
constexpr Register32 NVIC_ISER{0xE000E100};
constexpr unsigned IRQ_USB = 24;

inline void disable_interrupts() { __asm__ volatile("cpsid i" ::: "memory"); }
inline void enable_interrupts() { __asm__ volatile("cpsie i" ::: "memory"); }

// Until the end of a block.
class NoInterrupts {
public:
    NoInterrupts() { disable_interrupts(); }
    ~NoInterrupts() { enable_interrupts(); }
    NoInterrupts(const NoInterrupts&) = delete;
    NoInterrupts& operator=(const NoInterrupts&) = delete;
};

}  // namespace kl26

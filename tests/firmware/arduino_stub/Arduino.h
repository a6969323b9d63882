// The part of Teensyduino that the board layer uses, with the same declarations. simulated_teensy.cpp implements
// pins, converter, timer, memory, USB buffers and watchdogs, as in the maker's core and the chips' manuals.
#pragma once

#include <stddef.h>
#include <stdint.h>

#define HIGH 1
#define LOW 0
#define OUTPUT 1
#define INPUT_DISABLE 5
#define FLASHMEM

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);
int analogRead(uint8_t pin);
void analogReadRes(unsigned int bits);
#define analogReadResolution(bits) analogReadRes(bits)
void analogReadAveraging(unsigned int conversions);
void analogWrite(uint8_t pin, int value);
uint32_t analogWriteRes(uint32_t bits);
#define analogWriteResolution(bits) analogWriteRes(bits)
void analogWriteFrequency(uint8_t pin, float frequency);
uint32_t micros(void);
uint32_t millis(void);
extern "C" void yield(void);

void sim_interrupts(bool on);
#define __disable_irq() sim_interrupts(false)
#define __enable_irq() sim_interrupts(true)

void sim_idle();
#define PHLOSAR_IDLE() sim_idle()

// A register: the effect of a write depends on its kind and pin.
enum class Kind { kPlain, kPortClear, kPortSet, kDirection, kConfig, kWatchdog, kFeed, kResetCause };
struct Register {
    Kind kind;
    uint8_t pin;
    uint32_t value;
    Register& operator=(uint32_t written);
    Register& operator|=(uint32_t bits) { return *this = value | bits; }
    operator uint32_t() const { return value; }
};

#define SIM_PIN(n)                                                                                             \
    extern Register CORE_PIN##n##_PORTCLEAR, CORE_PIN##n##_PORTSET, CORE_PIN##n##_DDRREG, CORE_PIN##n##_CONFIG
SIM_PIN(6);
SIM_PIN(9);
SIM_PIN(11);
#define CORE_PIN6_BITMASK (1 << 6)
#define CORE_PIN9_BITMASK (1 << 9)
#define CORE_PIN11_BITMASK (1 << 11)

#if defined(__MKL26Z64__)
extern Register SIM_SCGC5, SIM_COPC, SIM_SRVCOP, RCM_SRS0, RCM_SRS1;
#define RCM_SRS0_WDOG ((uint8_t)0x20)
#define SIM_SCGC5_PORTC ((uint32_t)0x00000800)
#define SIM_SCGC5_PORTD ((uint32_t)0x00001000)
#define PORT_PCR_MUX(n) ((uint32_t)(((n) & 7) << 8))
#else
extern Register IOMUXC_GPR_GPR27, CCM_CCGR3, WDOG1_WCR, WDOG1_WSR, SRC_SRSR;
extern Register SNVS_LPSRTCLR, ARM_DWT_CYCCNT, HW_OCOTP_MAC0;
extern void (*volatile _VectorsRam[176])(void);
#define CCM_CCGR_ON 3
#define CCM_CCGR3_WDOG1(n) ((uint32_t)(((n) & 0x03) << 16))
#define SRC_SRSR_WDOG_RST_B ((uint32_t)(1 << 4))
#define WDOG_WCR_WDBG ((uint16_t)(1 << 1))
#define WDOG_WCR_WDE ((uint16_t)(1 << 2))
#define WDOG_WCR_SRS ((uint16_t)(1 << 4))
#define WDOG_WCR_WDA ((uint16_t)(1 << 5))
#define WDOG_WCR_WT(n) ((uint16_t)(((n) & 0xFF) << 8))
#endif

class usb_serial_class {
public:
    int available();
    size_t write(const uint8_t* buffer, size_t size);
    int availableForWrite();
    size_t readBytes(char* buffer, size_t length);
    void send_now(void);
    uint32_t baud(void);
    uint8_t dtr(void);
};
extern usb_serial_class Serial;

extern "C" void startup_early_hook();
extern "C" void systick_isr();
void setup();
void loop();

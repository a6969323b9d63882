// What the board layer uses of Teensyduino, declared as Teensyduino declares it for a Teensy LC, and nothing
// behind it: a compiler that checks the layer's syntax and types needs no more. It cannot be run.
#pragma once

#include <stddef.h>
#include <stdint.h>

#define HIGH 1
#define LOW 0
#define OUTPUT 1

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

#define __disable_irq() __asm__ volatile("" ::: "memory")
#define __enable_irq() __asm__ volatile("" ::: "memory")

extern volatile uint32_t SIM_SCGC5, SIM_COPC, SIM_SRVCOP, GPIOC_PCOR, GPIOC_PSOR, GPIOC_PDDR;
extern volatile uint32_t CORE_PIN9_CONFIG, CORE_PIN10_CONFIG, CORE_PIN11_CONFIG;
extern volatile uint8_t RCM_SRS0, RCM_SRS1;
#define RCM_SRS0_WDOG ((uint8_t)0x20)
#define SIM_SCGC5_PORTC ((uint32_t)0x00000800)
#define PORT_PCR_MUX(n) ((uint32_t)(((n) & 7) << 8))
#define CORE_PIN9_BITMASK (1 << 3)
#define CORE_PIN10_BITMASK (1 << 4)
#define CORE_PIN11_BITMASK (1 << 6)

class usb_serial_class {
public:
    virtual int available();
    virtual size_t write(const uint8_t* buffer, size_t size);
    virtual int availableForWrite();
    size_t readBytes(char* buffer, size_t length);
    void send_now(void);
    uint32_t baud(void);
    uint8_t dtr(void);
};
extern usb_serial_class Serial;

void setup();
void loop();

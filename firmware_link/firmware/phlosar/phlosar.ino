// The phloSAR's firmware for Teensy 4.0, 4.1 and LC. How to flash it: docs/first-flash.md.
#include "src/phlosar.h"

void setup() { phlosar::setup(); }

void loop() { phlosar::loop(); }

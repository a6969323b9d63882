// The phloSAR's firmware on a Teensy LC. How to build and flash it: docs/firmware.md; what to wire: docs/wiring.md.
#include "src/run.h"

void setup() { phlosar::begin(); }

void loop() { phlosar::turn(); }

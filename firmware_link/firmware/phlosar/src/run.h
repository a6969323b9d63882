// The firmware on its board.
//
// A timer's interrupt makes a control step each millisecond, and only it uses the firmware's core. The main loop
// moves bytes between the serial port and two rings, and stores settings. A main loop that waits or fails cannot
// keep a step from being made.
#pragma once

namespace phlosar {

void setup();
// As often as possible.
void loop();

}  // namespace phlosar

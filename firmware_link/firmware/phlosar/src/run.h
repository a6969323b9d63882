// The firmware on its board.
//
// A timer's interrupt makes a control step each millisecond, and only it uses the firmware's core. The main loop
// moves bytes between the serial port and two rings, and stores settings. The steps continue if the main loop
// waits or fails.
#pragma once

namespace phlosar {

void setup();
// Call it as often as possible.
void loop();

}  // namespace phlosar

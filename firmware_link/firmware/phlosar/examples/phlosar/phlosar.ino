// The phloSAR's firmware as it is flashed; add your own code in loop() only if it never waits.
#include <phlosar.h>

void setup() { phlosar::setup(); }

void loop() { phlosar::loop(); }

// The firmware on its board: a control step each millisecond, and bytes in and out between the steps.
#pragma once

#include <stdint.h>

namespace phlosar {

// Once.
void begin();
// Again and again, as often as can be.
void turn();

}  // namespace phlosar

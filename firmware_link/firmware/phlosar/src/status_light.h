// The patterns of the board's light.
#pragma once

#include <stdint.h>

#include "core/messages.h"

namespace phlosar {

// Venting: a short flash every two seconds. Regulating: on. Fault: n flashes and a pause, where n is the lowest
// latched bit, counted from 1.
bool light_on(Mode mode, uint16_t faults, uint32_t now_ms);

}  // namespace phlosar

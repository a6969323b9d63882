// What the board's light says to whoever stands next to it.
#pragma once

#include <stdint.h>

#include "core/messages.h"

namespace phlosar {

// Venting: a short flash every two seconds. Regulating: on. Fault: as many flashes as the lowest latched
// fault's bit has places, counted from 1, and a pause.
bool light_on(Mode mode, uint16_t faults, uint32_t now_ms);

}  // namespace phlosar

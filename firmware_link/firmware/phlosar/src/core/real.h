// The type of every quantity that is computed.
#pragma once

#include <stdint.h>
#include <string.h>

// Every board rounds alike: no product and sum in one instruction.
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("fp-contract=off")
#endif

#ifndef PHLOSAR_REAL
// Single precision is what the chip can afford. Studies on a host run the regulator in double precision.
#define PHLOSAR_REAL float
#endif

namespace phlosar {

using Real = PHLOSAR_REAL;

// Of two equal numbers the first.
constexpr Real smaller(Real a, Real b) { return b < a ? b : a; }
constexpr Real larger(Real a, Real b) { return b > a ? b : a; }

// True of every number but infinities and NaN.
inline bool is_finite(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return (bits & 0x7F800000u) != 0x7F800000u;
}

}  // namespace phlosar

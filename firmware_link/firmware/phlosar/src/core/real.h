// The type of every quantity that is computed.
#pragma once

#include <stdint.h>
#include <string.h>

// No fused multiply-add, so that every board rounds alike.
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("fp-contract=off")
#endif

#ifndef PHLOSAR_REAL
// Double precision is too slow on a Teensy LC. Studies on a host run the regulator in double precision.
#define PHLOSAR_REAL float
#endif

namespace phlosar {

using Real = PHLOSAR_REAL;

// The first one if both are equal.
constexpr Real smaller(Real a, Real b) { return b < a ? b : a; }
constexpr Real larger(Real a, Real b) { return b > a ? b : a; }

// False for infinities and NaN.
inline bool is_finite(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return (bits & 0x7F800000u) != 0x7F800000u;
}

}  // namespace phlosar

"""The paper's pressure regulator for real valves: on-off when far from the setpoint, PID when near.

A real inflation valve does nothing below some opening, follows late, and has play; a solenoid lets out air
for a while after it is told to close. So what counts is the pressure where it will be once the valves have
followed, and the opening from which on air flows is learned: it is the integral, which stays when the valve
shuts. Near the setpoint air goes in by puffs, each just large enough to pass it. Air leaves by itself where
that is fast enough; only otherwise does the Venturi help, for it costs air.

The model of `firmware_link/firmware/phlosar/src/core/regulator.cpp`, operation by operation: tests hold the
two together to the last bit. Plain functions over tuples of floats and bools, in the part of the language
that a compiler for numbers understands as well: what is remembered comes in and goes out. What divides only
by settings and `dt_s` is written so that the firmware need not divide in its step.
"""

from __future__ import annotations

from typing import NamedTuple

_RATED_SUPPLY_KPA_ABS = 791.0
_AMBIENT_KPA = 101.0
_FIRST_INTEGRAL = 0.2


class Drive(NamedTuple):
    """What the valves are told: openings 0…1, solenoid open or not."""

    evp: float
    dvp: float
    solenoid: bool


SAFE = Drive(0.0, 0.0, True)
"""Nothing goes in, everything may leave, and no air is spent on it."""


class RegulatorSettings(NamedTuple):
    """Good from 0.05 to 1 litre, on 100 to 690 kPa."""

    filter_s: float = 0.003
    slope_filter_s: float = 0.008
    on_off_error_kPa: float = 1.5
    """Of the pressure to come. Farther below the setpoint the inflation valve goes fully open …"""
    opening_s: float = 0.12
    """… in this time: what flows before the sensor tells would otherwise be too much for a small vine."""
    filling_lead_s: float = 0.03
    """How far ahead is looked while air goes in: delay and lag of valve, sensor and filters."""
    proportional_per_kPa: float = 0.03
    """On 690 kPa; on less in proportion more, for choked flow goes with the absolute pressure."""
    integral_per_kPa_s: float = 1.5
    integral_most: float = 0.55
    """Beyond the largest dead zone."""
    integral_forgets: float = 0.015
    """With each puff, so that the next one begins with no flow."""
    puff_begins_kPa: float = 0.15
    puff_ends_kPa: float = 0.05
    """Below and above the setpoint."""
    puff_overtakes_kPa: float = 0.25
    """A puff also ends when the pressure to come is this much above the setpoint."""
    venting_lead_s: float = 0.02
    """How long the solenoid lets air out after it is told to close."""
    tolerated_kPa: float = 0.3
    """Above the setpoint. More is let out, the more the sooner …"""
    patience_kPa_s: float = 0.06
    """… when excess times time comes to this: after a fill gas cools, and falls by itself."""
    warming_s: float = 0.15
    """After a vent gas warms, and rises by itself: what fell too far is not filled up before."""
    waiting_s: float = 0.3
    """What is beyond a setpoint that moves is left alone if the setpoint will be there within this."""
    active_error_kPa: float = 3.0
    """Nearer than this the Venturi is not started …"""
    passive_error_kPa: float = 1.0
    """… and nearer than this it is stopped."""
    passive_first_s: float = 0.03
    """How long air may leave by itself before its speed is judged."""
    arrival_s: float = 0.3
    """Within this the pressure should arrive at a setpoint that stands still."""
    venturi_least_supply_kPa: float = 100.0
    """Below it the Venturi spends air and makes no vacuum to speak of."""


class RegulatorMemory(NamedTuple):
    """Everything that one step hands to the next."""

    setpoint_kPa: float
    """What is held now, on its way to the target."""
    cv_kPa: float
    """Filtered, and its slope."""
    slope_kPa_per_s: float
    integral: float
    """The opening at which air begins to flow, as far as it is known."""
    evp: float
    """As told last."""
    excess_kPa_s: float
    venting_s: float
    """For how long the solenoid has been told to be open; below 0, for how long air that was let out is
    given time to warm."""
    venturi: bool


def begin(cv_kPa: float) -> RegulatorMemory:
    """A regulation begins: the setpoint is the measured pressure, so that nothing jumps."""
    return RegulatorMemory(max(0.0, cv_kPa), cv_kPa, 0.0, _FIRST_INTEGRAL, 0.0, 0.0, 0.0, False)


def regulate(
    settings: RegulatorSettings,
    memory: RegulatorMemory,
    target_kPa: float,
    rate_kPa_per_s: float,
    dt_s: float,
    cv_kPa: float,
    reservoir_kPa: float,
) -> tuple[RegulatorMemory, Drive]:
    """The valves for the next `dt_s` (positive), from pressures just read, and what to remember.

    The setpoint goes towards `target_kPa`, at most `rate_kPa_per_s` fast.
    """
    most = rate_kPa_per_s * dt_s
    move = min(most, max(-most, target_kPa - memory.setpoint_kPa))
    per_s = 1.0 / dt_s
    setpoint_slope = move * per_s
    setpoint = memory.setpoint_kPa + move
    change = (cv_kPa - memory.cv_kPa) * (dt_s / (settings.filter_s + dt_s))
    cv = memory.cv_kPa + change
    slope = memory.slope_kPa_per_s
    slope += (change * per_s - slope) * (dt_s / (settings.slope_filter_s + dt_s))
    error = setpoint - cv
    closing = setpoint_slope - slope

    excess_kPa_s = venting_s = evp = dvp = 0.0
    venturi = False
    integral = memory.integral
    if memory.venting_s > 0.0:
        vent = error + closing * settings.venting_lead_s < 0.0
    else:
        excess = -error - settings.tolerated_kPa - max(0.0, setpoint_slope) * settings.waiting_s
        if excess > 0.0:
            excess_kPa_s = memory.excess_kPa_s + excess * dt_s
        vent = excess_kPa_s > settings.patience_kPa_s
    # At rest whatever is left, or leaks in, may leave.
    if vent or setpoint <= 0.0:
        venting_s = max(0.0, memory.venting_s) + dt_s
        venturi = _venturi(settings, memory, error, setpoint_slope, slope, reservoir_kPa)
        dvp = 1.0 if venturi else 0.0
    else:
        venting_s = -settings.warming_s if memory.venting_s > 0.0 else min(0.0, memory.venting_s + dt_s)
        warm = venting_s == 0.0 or move > 0.0
        if warm and (move >= 0.0 or error > -setpoint_slope * settings.waiting_s):
            evp, integral = _inflation(settings, memory, dt_s, error, closing, reservoir_kPa)
    return (
        RegulatorMemory(setpoint, cv, slope, integral, evp, excess_kPa_s, venting_s, venturi),
        Drive(evp, dvp, venting_s > 0.0),
    )


def _inflation(
    settings: RegulatorSettings,
    memory: RegulatorMemory,
    dt_s: float,
    error: float,
    closing: float,
    reservoir_kPa: float,
) -> tuple[float, float]:
    """The inflation valve and the integral; `closing` is how fast the setpoint runs away, kPa/s."""
    ahead = error + closing * settings.filling_lead_s
    integral = memory.integral
    if error > 0.0 and ahead > settings.on_off_error_kPa:
        return min(1.0, max(memory.evp, integral) + dt_s / settings.opening_s), integral
    if memory.evp > 0.0:
        puff = error > -settings.puff_ends_kPa and ahead > -settings.puff_overtakes_kPa
    else:
        puff = error > settings.puff_begins_kPa and ahead > -settings.puff_overtakes_kPa
    if puff:
        integral += settings.integral_per_kPa_s * max(0.0, error) * dt_s
        integral = min(settings.integral_most, integral)
        supply_kPa_abs = max(0.0, reservoir_kPa) + _AMBIENT_KPA
        gain = settings.proportional_per_kPa * _RATED_SUPPLY_KPA_ABS / supply_kPa_abs
        return min(1.0, integral + gain * max(0.0, ahead)), integral
    if memory.evp > 0.0:
        # More after a puff from near that runs far beyond; one from afar has to run.
        forgotten = settings.integral_forgets * (1.0 + max(0.0, -ahead - error))
        integral = max(0.0, integral - forgotten)
    return 0.0, integral


def _venturi(
    settings: RegulatorSettings,
    memory: RegulatorMemory,
    error: float,
    setpoint_slope: float,
    slope: float,
    reservoir_kPa: float,
) -> bool:
    """Whether the Venturi helps to let air out."""
    if reservoir_kPa < settings.venturi_least_supply_kPa or error > -settings.passive_error_kPa:
        return False
    if memory.venturi or error > -settings.active_error_kPa or memory.venting_s < settings.passive_first_s:
        return memory.venturi
    return -slope * settings.arrival_s < max(-setpoint_slope * settings.arrival_s, -error)

"""Hardware failures (mishaps) of a phloSAR: the kinds, and the places where they may occur.

A kind is a frozen dataclass whose repr is valid Python. `Mishaps` has the present failures by place.
`SimulatedPhlosar` applies them. EVP: inflation valve. DVP: the Venturi's supply valve.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from math import inf, isfinite, pi
from typing import Any, NamedTuple

from flying_vines.physics.gas import ALPHA_KPA, STANDARD_PRESSURE_KPA
from flying_vines.physics.plant.flow import Iso6358, Ohm, Opening, flow_SL_per_s
from flying_vines.physics.plant.leak import Leak
from flying_vines.physics.plant.numbers import PlantNumbers, ValveNumbers

OPEN_SHARE = -0.125
"""Reading of a ratiometric 0.5 … 4.5 V sensor at 0 V, as a share of its span."""
SHORTED_SHARE = 1.125
"""Reading of the same sensor at its supply voltage, 5 V."""
_STUB_L = 0.004
"""Volume that stays at the valves when the hose comes off or is kinked; only for a rig without tubing."""
WATCHDOG_MS = 256
"""The watchdog resets a hanging board after this time."""
_SONIC_SL_PER_S_KPA_MM2 = 1.27e-3
"""Choked flow of air at 20 °C per mm² of a sharp-edged hole (discharge coefficient 0.65). Assumption."""
_FULL_RESERVOIR_KPA = 690.0
_BENT_VINE_KPA = 20.0


def _check(holds: bool, sentence: str) -> None:
    if not holds:
        raise ValueError(sentence)


class SensorReading(NamedTuple):
    """A sensor reading, and the data that a mishap may use to change it."""

    kPa: float
    """The reading without the mishap."""
    last_good_kPa: float
    """The last good reading."""
    for_ms: int
    """Time since the mishap began."""
    normal: Callable[[], float]
    """A standard normal number."""


# Sensors. `SimulatedPhlosar` limits the readings to the voltage range of the wire.


@dataclass(frozen=True)
class Stuck:
    """The sensor repeats its last good reading."""

    def read(self, reading: SensorReading) -> float:
        return reading.last_good_kPa


@dataclass(frozen=True)
class Drifting:
    """The sensor's error grows with time."""

    kPa_per_s: float

    def read(self, reading: SensorReading) -> float:
        return reading.kPa + self.kPa_per_s * reading.for_ms / 1000.0


@dataclass(frozen=True)
class Open:
    """Broken wire: 0 V."""

    def read(self, reading: SensorReading) -> float:
        return -inf


@dataclass(frozen=True)
class Shorted:
    """Short circuit to the sensor's supply."""

    def read(self, reading: SensorReading) -> float:
        return inf


@dataclass(frozen=True)
class Noisy:
    """Additional noise."""

    std_kPa: float

    def __post_init__(self) -> None:
        _check(self.std_kPa >= 0.0, "noise must not be negative")

    def read(self, reading: SensorReading) -> float:
        return reading.kPa + self.std_kPa * reading.normal()


@dataclass(frozen=True)
class Gain:
    """The reading is multiplied by `factor`; 0: dead sensor."""

    factor: float

    def read(self, reading: SensorReading) -> float:
        return self.factor * reading.kPa


@dataclass(frozen=True)
class Glitching:
    """Single wrong readings: the first at once, then one every `every_ms`."""

    kPa: float
    every_ms: float = 100.0

    def __post_init__(self) -> None:
        _check(self.every_ms >= 1.0, "every_ms must be at least 1 ms")

    def read(self, reading: SensorReading) -> float:
        return self.kPa if (reading.for_ms - 1) % self.every_ms < 1.0 else reading.kPa


SensorMishap = Stuck | Drifting | Open | Shorted | Noisy | Gain | Glitching


# Valves.


@dataclass(frozen=True)
class StuckAt:
    """A valve is stuck at this opening, 0…1. A solenoid is open from 0.5 on."""

    opening: float

    def __post_init__(self) -> None:
        _check(0.0 <= self.opening <= 1.0, "an opening must be in 0…1")


@dataclass(frozen=True)
class Blocked:
    """The Venturi's exhaust is blocked: nothing leaves, and its supply goes into the vine.

    Assumption: it passes as much as the inflation valve at the same opening.
    """


# Reservoir, hose and actuator.


@dataclass(frozen=True)
class Hole:
    """A round hole to ambient. 0.1 … 0.5 mm is a slow leak, several mm a burst."""

    bore_mm: float

    def __post_init__(self) -> None:
        _check(self.bore_mm > 0.0, "a hole must be larger than 0 mm")

    @property
    def opening(self) -> Opening:
        area_mm2 = pi * self.bore_mm**2 / 4.0
        # A wider laminar range than a valve's, otherwise a small volume would need very short time steps.
        return Iso6358(_SONIC_SL_PER_S_KPA_MM2 * area_mm2, laminar_ratio=0.98).numbers()


@dataclass(frozen=True)
class HoseOff:
    """The hose is off at the valves: valves and actuator are open to ambient."""


@dataclass(frozen=True)
class Kinked:
    """The hose is kinked and has this total flow resistance."""

    flow_resistance_kPa_s_per_SL: float = inf

    def __post_init__(self) -> None:
        _check(self.flow_resistance_kPa_s_per_SL > 0.0, "a flow resistance must be positive")


@dataclass(frozen=True)
class Filled:
    """The reservoir is filled or emptied to this pressure at once."""

    kPa: float

    def __post_init__(self) -> None:
        _check(self.kPa >= 0.0, "a reservoir's pressure must not be below ambient")


@dataclass(frozen=True)
class Heated:
    """Reservoir and air become warmer by this temperature at once."""

    kelvin: float

    def __post_init__(self) -> None:
        _check(self.kelvin > -100.0, "a reservoir must not be cooled by 100 K or more")


# The board.


@dataclass(frozen=True)
class Unpowered:
    """No power: no communication, and springs close all valves, the outlet too.

    The board boots when power returns.
    """


@dataclass(frozen=True)
class Hanging:
    """The firmware stops and the valves stay, until the watchdog resets the board after 256 ms."""


@dataclass(frozen=True)
class Reset:
    """A short power loss."""


@dataclass(frozen=True)
class WatchdogReset:
    """A watchdog reset."""


MishapKind = (
    SensorMishap
    | StuckAt
    | Blocked
    | Hole
    | HoseOff
    | Kinked
    | Filled
    | Heated
    | Unpowered
    | Hanging
    | Reset
    | WatchdogReset
)


@dataclass
class Mishaps:
    """The present mishaps by place. Holes are in addition to the rig's own leaks."""

    cv_sensor: SensorMishap | None = None
    reservoir_sensor: SensorMishap | None = None
    evp: StuckAt | None = None
    dvp: StuckAt | None = None
    solenoid: StuckAt | None = None
    venturi: Blocked | None = None
    hose: HoseOff | Kinked | None = None
    actuator: Hole | None = None
    reservoir: Hole | None = None
    board: Unpowered | Hanging | None = None


_SENSOR: Mapping[str, type[Any]] = {
    "stuck": Stuck,
    "drifting": Drifting,
    "open": Open,
    "shorted": Shorted,
    "noisy": Noisy,
    "gain": Gain,
    "glitching": Glitching,
}

PLACES: Mapping[str, Mapping[str, type[Any]]] = {
    "cv_sensor": _SENSOR,
    "reservoir_sensor": _SENSOR,
    "evp": {"stuck": StuckAt},
    "dvp": {"stuck": StuckAt},
    "solenoid": {"stuck": StuckAt},
    "venturi": {"blocked": Blocked},
    "hose": {"off": HoseOff, "kinked": Kinked},
    "actuator": {"hole": Hole},
    "reservoir": {"hole": Hole, "filled": Filled, "heated": Heated},
    "board": {"unpowered": Unpowered, "hanging": Hanging, "reset": Reset, "watchdog": WatchdogReset},
}
"""The possible mishaps of each place, by their typed words."""


def check_place(place: str, kind: MishapKind | None) -> None:
    """Raises `ValueError` with a sentence if this place does not exist or cannot have this mishap."""
    _check(place in PLACES, f"{place} is not a place; the places are {', '.join(PLACES)}")
    possible = kind is None or isinstance(kind, tuple(PLACES[place].values()))
    _check(possible, f"{place} cannot have {kind}")


def words_for(place: str, word: str) -> str:
    """The typed form: the word and its numbers; those in [] are optional."""
    numbers = (f.name if f.default is MISSING else f"[{f.name}]" for f in fields(PLACES[place][word]))
    return " ".join([word, *numbers])


def kind_from(place: str, words: list[str]) -> MishapKind:
    """The mishap for typed words (`hole 0.3`). Raises `ValueError` with a sentence."""
    known = PLACES[place]
    if not words or words[0] not in known:
        raise ValueError(f"{place} may have: {', '.join(words_for(place, word) for word in known)}")
    word, *numbers = words
    try:
        values = [float(number) for number in numbers]
    except ValueError as error:
        raise ValueError(f"{' '.join(words)}: {error}") from None
    if not all(map(isfinite, values)):
        raise ValueError(f"{' '.join(words)}: numbers must be finite")
    try:
        made: MishapKind = known[word](*values)
    except TypeError:
        raise ValueError(f"{place} takes: {words_for(place, word)}") from None
    return made


_HOSE_BORE = Hole(4.0)


def with_mishaps(healthy: PlantNumbers, mishaps: Mishaps) -> PlantNumbers:
    """The plant's numbers with these mishaps."""
    numbers = healthy._replace(evp=_stuck(healthy.evp, mishaps.evp), dvp=_stuck(healthy.dvp, mishaps.dvp))
    if mishaps.reservoir is not None:
        leak = _with_hole(healthy.reservoir_leak, mishaps.reservoir.opening, _FULL_RESERVOIR_KPA)
        through = healthy.evp.law.steepest_SL_per_s_kPa + healthy.dvp.law.steepest_SL_per_s_kPa
        quickest_per_s = (
            healthy.gamma * ALPHA_KPA * healthy.reservoir_per_L * (through + leak.steepest_SL_per_s_kPa)
        )
        numbers = numbers._replace(
            reservoir_leak=leak, standing_per_s=max(healthy.standing_per_s, quickest_per_s)
        )
    if mishaps.actuator is not None:
        leak = _with_hole(healthy.cv_leak, mishaps.actuator.opening, _BENT_VINE_KPA)
        numbers = numbers._replace(cv_leak=leak)
    match mishaps.hose:
        case HoseOff():
            # The actuator empties through the rest of its hose.
            tube = (
                Ohm(1.0 / healthy.line_SL_per_s_kPa).numbers() if healthy.has_tubing else _HOSE_BORE.opening
            )
            leak = _with_hole(numbers.cv_leak, tube, _BENT_VINE_KPA)
            numbers = _parted(numbers)._replace(line_hole=_HOSE_BORE.opening, cv_leak=leak)
        case Kinked(flow_resistance_kPa_s_per_SL):
            numbers = _parted(numbers)._replace(line_SL_per_s_kPa=1.0 / flow_resistance_kPa_s_per_SL)
    return numbers


def _stuck(valve: ValveNumbers, mishap: StuckAt | None) -> ValveNumbers:
    return valve if mishap is None else valve._replace(stuck_opening=mishap.opening)


def _parted(numbers: PlantNumbers) -> PlantNumbers:
    """The plant's numbers without the connection between valves and actuator."""
    if numbers.has_tubing:
        return numbers._replace(line_SL_per_s_kPa=0.0)
    cv = numbers.cv
    stub_L = min(_STUB_L, 0.5 * cv.flat_L)
    rest = cv._replace(
        flat_L=cv.flat_L - stub_L,
        full_L=cv.full_L - stub_L,
        flat_edge_L=cv.flat_edge_L - stub_L,
        full_edge_L=cv.full_edge_L - stub_L,
    )
    return numbers._replace(
        has_tubing=True, cv=rest, line_kPa_per_SL=ALPHA_KPA / stub_L, line_SL_per_s_kPa=0.0
    )


def _with_hole(own: Leak, hole: Opening, at_kPa: float) -> Leak:
    """The leaks and one more hole; two orifices become one with the same flow at `at_kPa` (gauge)."""
    steepest = own.steepest_SL_per_s_kPa + hole.steepest_SL_per_s_kPa
    if hole.ohmic:
        ohmic = own.ohmic_SL_per_s_kPa + hole.conductance_SL_per_s_kPa
        return own._replace(ohmic_SL_per_s_kPa=ohmic, steepest_SL_per_s_kPa=steepest)
    if own.orifice.conductance_SL_per_s_kPa == 0.0:
        return own._replace(orifice=hole, steepest_SL_per_s_kPa=steepest)
    inside, outside = at_kPa + STANDARD_PRESSURE_KPA, STANDARD_PRESSURE_KPA
    already = flow_SL_per_s(own.orifice, inside, outside, 1.0, 1.0)
    already /= flow_SL_per_s(hole, inside, outside, 1.0, 1.0)
    both = hole._replace(
        conductance_SL_per_s_kPa=(1.0 + already) * hole.conductance_SL_per_s_kPa,
        steepest_SL_per_s_kPa=(1.0 + already) * hole.steepest_SL_per_s_kPa,
    )
    return own._replace(orifice=both, steepest_SL_per_s_kPa=steepest + already * hole.steepest_SL_per_s_kPa)

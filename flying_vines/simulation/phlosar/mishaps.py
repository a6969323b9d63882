"""What can go wrong with the hardware of a phloSAR: each kind a description, and where it may happen.

A kind is a frozen dataclass that prints as what makes it again. `Mishaps` says what is wrong at present,
place by place; a `Mishap` is one with its times, and `draw_mishap` thinks one up. Nothing here acts:
`SimulatedPhlosar` makes its rig, its readings and its board so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from math import inf, isfinite, pi
from random import Random
from typing import Any, NamedTuple

from flying_vines.physics.constants import ALPHA_KPA, GAMMA, STANDARD_PRESSURE_KPA
from flying_vines.physics.plant.flow import Iso6358, Ohm, Opening, flow_SL_per_s
from flying_vines.physics.plant.numbers import PlantNumbers, ValveNumbers

OPEN_SHARE = -0.125
"""What a ratiometric sensor of 0.5 to 4.5 V reads of its span at 0 V …"""
SHORTED_SHARE = 1.125
"""… and at its supply of 5 V."""
_STUB_L = 0.004
"""Of a rig without tubing: what of the actuator's volume stays with the valves when the two are parted."""
WATCHDOG_MS = 256
"""For so long a board may hang."""
_SONIC_SL_PER_S_KPA_MM2 = 1.27e-3
"""Choked flow of air at 20 °C through 1 mm², of which 0.65 count: a sharp-edged hole. Assumption."""
_FULL_BOTTLE_KPA = 690.0
_BENT_VINE_KPA = 20.0


def _check(holds: bool, sentence: str) -> None:
    if not holds:
        raise ValueError(sentence)


class Reading(NamedTuple):
    """A reading that a sensor is about to give, and what its mishap may go by."""

    kPa: float
    """If it were well."""
    last_well_kPa: float
    """The last one that was."""
    for_ms: int
    """Since then."""
    normal: Callable[[], float]
    """A standard normal number."""


# Sensors. What comes of each is kept within what its wire can carry.


@dataclass(frozen=True)
class Stuck:
    """It reads what it read last."""

    def read(self, reading: Reading) -> float:
        return reading.last_well_kPa


@dataclass(frozen=True)
class Drifting:
    """It goes astray."""

    kPa_per_s: float

    def read(self, reading: Reading) -> float:
        return reading.kPa + self.kPa_per_s * reading.for_ms / 1000.0


@dataclass(frozen=True)
class Open:
    """A broken wire: 0 V."""

    def read(self, reading: Reading) -> float:
        return -inf


@dataclass(frozen=True)
class Shorted:
    """To its supply."""

    def read(self, reading: Reading) -> float:
        return inf


@dataclass(frozen=True)
class Noisy:
    """So much noise beside its own."""

    std_kPa: float

    def __post_init__(self) -> None:
        _check(self.std_kPa >= 0.0, "noise is not negative")

    def read(self, reading: Reading) -> float:
        return reading.kPa + self.std_kPa * reading.normal()


@dataclass(frozen=True)
class Gain:
    """It reads so many times what it should; 0 is a dead one."""

    factor: float

    def read(self, reading: Reading) -> float:
        return self.factor * reading.kPa


@dataclass(frozen=True)
class Glitching:
    """One reading is this, at once and then every so often."""

    kPa: float
    every_ms: float = 100.0

    def __post_init__(self) -> None:
        _check(self.every_ms >= 1.0, "glitches come every 1 ms or more")

    def read(self, reading: Reading) -> float:
        return self.kPa if (reading.for_ms - 1) % self.every_ms < 1.0 else reading.kPa


SensorMishap = Stuck | Drifting | Open | Shorted | Noisy | Gain | Glitching


# Valves.


@dataclass(frozen=True)
class StuckAt:
    """A valve goes to this opening, 0…1, and stays whatever it is told. A solenoid is open from 0.5 on."""

    opening: float

    def __post_init__(self) -> None:
        _check(0.0 <= self.opening <= 1.0, "an opening lies in 0…1")


# What holds air.


@dataclass(frozen=True)
class Hole:
    """A round hole to ambient: a slow leak of 0.1 to 0.5 mm, a burst of several."""

    bore_mm: float

    def __post_init__(self) -> None:
        _check(self.bore_mm > 0.0, "a hole is larger than 0 mm")

    @property
    def opening(self) -> Opening:
        area_mm2 = pi * self.bore_mm**2 / 4.0
        # A wider straight end than a valve's, which a small volume could not follow in few steps.
        return Iso6358(_SONIC_SL_PER_S_KPA_MM2 * area_mm2, laminar_ratio=0.98).numbers()


@dataclass(frozen=True)
class HoseOff:
    """The hose is off at the valves: they and the actuator end in the open."""


@dataclass(frozen=True)
class Kinked:
    """The hose passes little, or nothing: this is all of its resistance from then on."""

    flow_resistance_kPa_s_per_SL: float = inf

    def __post_init__(self) -> None:
        _check(self.flow_resistance_kPa_s_per_SL > 0.0, "a flow resistance is positive")


@dataclass(frozen=True)
class Filled:
    """Someone fills the bottle to this pressure, or empties it to there, at once."""

    kPa: float

    def __post_init__(self) -> None:
        _check(self.kPa >= 0.0, "a bottle is not filled below ambient pressure")


@dataclass(frozen=True)
class Heated:
    """The bottle and its air are so much warmer, at once."""

    kelvin: float

    def __post_init__(self) -> None:
        _check(self.kelvin > -100.0, "a bottle is not cooled by 100 K")


# The board.


@dataclass(frozen=True)
class Unpowered:
    """No power: nothing is heard or said, and springs close all valves, the outlet too. Then it boots."""


@dataclass(frozen=True)
class Hanging:
    """No step is made and the valves stay as they are, until the watchdog resets it after 256 ms."""


@dataclass(frozen=True)
class Reset:
    """The power blinks."""


@dataclass(frozen=True)
class WatchdogReset:
    """The watchdog barks."""


MishapKind = (
    SensorMishap
    | StuckAt
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
Momentary = Filled | Heated | Reset | WatchdogReset
"""What happens, and is over."""


@dataclass
class Mishaps:
    """What is wrong at present. None is well.

    What a hole in the bottle lets out, and one in the actuator, comes beside the leaks that the rig has.
    """

    cv_sensor: SensorMishap | None = None
    reservoir_sensor: SensorMishap | None = None
    evp: StuckAt | None = None
    dvp: StuckAt | None = None
    solenoid: StuckAt | None = None
    hose: HoseOff | Kinked | None = None
    actuator: Hole | None = None
    bottle: Hole | None = None
    board: Unpowered | Hanging | None = None


@dataclass(frozen=True)
class Mishap:
    """A kind at a place, from one time on and to another; None: it stays."""

    place: str
    kind: MishapKind
    begins_s: float
    ends_s: float | None = None

    def __post_init__(self) -> None:
        _check(self.place in PLACES, f"{self.place} is no place: the places are {', '.join(PLACES)}")
        _check(
            isinstance(self.kind, tuple(PLACES[self.place].values())),
            f"{self.place} cannot suffer {self.kind}",
        )
        _check(self.ends_s is None or self.ends_s >= self.begins_s, "a mishap ends after it begins")


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
    "hose": {"off": HoseOff, "kinked": Kinked},
    "actuator": {"hole": Hole},
    "bottle": {"hole": Hole, "filled": Filled, "heated": Heated},
    "board": {"unpowered": Unpowered, "hanging": Hanging, "reset": Reset, "watchdog": WatchdogReset},
}
"""What each place may suffer, by the words for it."""


def words_for(place: str, word: str) -> str:
    """How a person says it: the word, and the numbers that it takes; [those] may be left out."""
    numbers = (f.name if f.default is MISSING else f"[{f.name}]" for f in fields(PLACES[place][word]))
    return " ".join([word, *numbers])


def kind_from(place: str, words: list[str]) -> MishapKind:
    """What a person's words mean: `hole 0.3`. ValueError, with a sentence, where they mean nothing."""
    known = PLACES[place]
    if not words or words[0] not in known:
        raise ValueError(f"{place} may suffer: {', '.join(words_for(place, word) for word in known)}")
    word, *numbers = words
    try:
        values = [float(number) for number in numbers]
    except ValueError as error:
        raise ValueError(f"{' '.join(words)}: {error}") from None
    if not all(map(isfinite, values)):
        raise ValueError(f"{' '.join(words)}: numbers are finite")
    try:
        made: MishapKind = known[word](*values)
    except TypeError:
        raise ValueError(f"{place} takes: {words_for(place, word)}") from None
    return made


DRAWN: tuple[tuple[str, Callable[[Random], MishapKind]], ...] = (
    ("cv_sensor", lambda _: Stuck()),
    ("cv_sensor", lambda r: Drifting(_either_way(r, 0.2, 20.0))),
    ("cv_sensor", lambda _: Open()),
    ("cv_sensor", lambda _: Shorted()),
    ("cv_sensor", lambda r: Noisy(_log_uniform(r, 0.5, 10.0))),
    ("cv_sensor", lambda r: Gain(r.choice([0.0, r.uniform(0.5, 1.5)]))),
    ("cv_sensor", lambda r: Glitching(r.uniform(-20.0, 200.0), _log_uniform(r, 5.0, 5000.0))),
    ("reservoir_sensor", lambda _: Stuck()),
    ("reservoir_sensor", lambda r: Drifting(_either_way(r, 2.0, 200.0))),
    ("reservoir_sensor", lambda _: Open()),
    ("reservoir_sensor", lambda _: Shorted()),
    ("reservoir_sensor", lambda r: Noisy(_log_uniform(r, 3.0, 50.0))),
    ("reservoir_sensor", lambda r: Gain(r.choice([0.0, r.uniform(0.5, 1.5)]))),
    ("reservoir_sensor", lambda r: Glitching(r.uniform(-150.0, 1500.0), _log_uniform(r, 5.0, 5000.0))),
    ("evp", lambda _: StuckAt(1.0)),
    ("evp", lambda _: StuckAt(0.0)),
    ("evp", lambda r: StuckAt(r.uniform(0.02, 0.5))),
    ("dvp", lambda _: StuckAt(1.0)),
    ("dvp", lambda _: StuckAt(0.0)),
    ("solenoid", lambda _: StuckAt(1.0)),
    ("solenoid", lambda _: StuckAt(0.0)),
    ("hose", lambda _: HoseOff()),
    ("hose", lambda _: Kinked()),
    ("hose", lambda r: Kinked(_log_uniform(r, 50.0, 5000.0))),
    ("actuator", lambda r: Hole(r.uniform(2.0, 8.0))),
    ("actuator", lambda r: Hole(_log_uniform(r, 0.05, 0.5))),
    ("bottle", lambda r: Hole(_log_uniform(r, 0.1, 5.0))),
    ("bottle", lambda _: Filled(0.0)),
    ("bottle", lambda r: Filled(r.uniform(765.0, 900.0))),
    ("bottle", lambda r: Heated(r.uniform(10.0, 60.0))),
    ("board", lambda _: Unpowered()),
    ("board", lambda _: Hanging()),
    ("board", lambda _: Reset()),
    ("board", lambda _: WatchdogReset()),
)
"""What `draw_mishap` draws from, each as likely as the others."""


def draw_mishap(random: Random, within_s: float) -> Mishap:
    """One that begins within so long, and in half of the draws ends within it."""
    place, make = random.choice(DRAWN)
    kind = make(random)
    begins_s = random.uniform(0.0, within_s)
    ends = random.random() < 0.5 and not isinstance(kind, Momentary)
    return Mishap(place, kind, begins_s, random.uniform(begins_s, within_s) if ends else None)


_HOSE_BORE = Hole(4.0)


def with_mishaps(well: PlantNumbers, mishaps: Mishaps) -> PlantNumbers:
    """The plant as it is with all this wrong with it."""
    numbers = well._replace(evp=_stuck(well.evp, mishaps.evp), dvp=_stuck(well.dvp, mishaps.dvp))
    if mishaps.bottle is not None:
        leak = _beside(well.reservoir_leak, mishaps.bottle.opening, _FULL_BOTTLE_KPA)
        through = well.evp.law.steepest_SL_per_s_kPa + well.dvp.law.steepest_SL_per_s_kPa
        quickest_per_s = GAMMA * ALPHA_KPA * well.reservoir_per_L * (through + leak.steepest_SL_per_s_kPa)
        numbers = numbers._replace(
            reservoir_leak=leak, standing_per_s=max(well.standing_per_s, quickest_per_s)
        )
    if mishaps.actuator is not None:
        leak = _beside(well.cv_leak, mishaps.actuator.opening, _BENT_VINE_KPA)
        numbers = numbers._replace(cv_leak=leak)
    match mishaps.hose:
        case HoseOff():
            # The actuator empties through what is left on it.
            tube = Ohm(1.0 / well.line_SL_per_s_kPa).numbers() if well.has_tubing else _HOSE_BORE.opening
            leak = _beside(numbers.cv_leak, tube, _BENT_VINE_KPA)
            numbers = _parted(numbers)._replace(line_hole=_HOSE_BORE.opening, cv_leak=leak)
        case Kinked(flow_resistance_kPa_s_per_SL):
            numbers = _parted(numbers)._replace(line_SL_per_s_kPa=1.0 / flow_resistance_kPa_s_per_SL)
    return numbers


def _stuck(valve: ValveNumbers, mishap: StuckAt | None) -> ValveNumbers:
    return valve if mishap is None else valve._replace(stuck_opening=mishap.opening)


def _parted(numbers: PlantNumbers) -> PlantNumbers:
    """Nothing passes between valves and actuator."""
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


def _beside(own: Opening, hole: Opening, at_kPa: float) -> Opening:
    """Both as one hole, which passes at this pressure what they pass."""
    inside, outside = at_kPa + STANDARD_PRESSURE_KPA, STANDARD_PRESSURE_KPA
    already = flow_SL_per_s(own, inside, outside, 1.0, 1.0) / flow_SL_per_s(hole, inside, outside, 1.0, 1.0)
    return hole._replace(
        conductance_SL_per_s_kPa=(1.0 + already) * hole.conductance_SL_per_s_kPa,
        steepest_SL_per_s_kPa=(1.0 + already) * hole.steepest_SL_per_s_kPa,
    )


def _log_uniform(random: Random, least: float, most: float) -> float:
    return float(least * (most / least) ** random.random())


def _either_way(random: Random, least: float, most: float) -> float:
    return random.choice([-1.0, 1.0]) * _log_uniform(random, least, most)

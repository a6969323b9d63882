"""How much a diagnosis improves the cycles left: rigs with hidden causes, estimated from two rig files.

Each rig is recorded for a minute, in four runs, and diagnosed from these runs. Then it flies until its
reservoir is empty, with two estimates: one starts from the nominal rig, the other from the file of `diagnose
--write-rig`. No diagnosis sees a flight. `HIDDEN` has all causes and their strengths. The effects are clear,
as on real rigs, but the leaks are small enough for thirty cycles.
"""

from __future__ import annotations

import random
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean, median

from cycles_left_flights import FEWEST_CYCLES, began, fly, telemetry_messages
from cycles_left_guess import Guess, by_paper, quantity
from cycles_left_rigs import Case, Manoeuvre, log_uniform
from rich.table import Table

from flying_vines.config.config import PneumaticsConfig
from flying_vines.identification.case import read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.extended import extended_rig
from flying_vines.physics.plant.true_rig import TrueRig, load_true_rig, true_rig_text
from flying_vines.physics.rig import ControlVolume, Dvp, Evp, Reservoir, Rig, Solenoid
from flying_vines.simulation.scenario import parse_scenario, simulate_scenario, write_case
from flying_vines.supply import ReservoirEstimate, TelemetryReader
from flying_vines.supply.rig_file_prior import TOP_SHARE, prior_of

Causes = Mapping[str, Mapping[str, float]]
MOMENTS = {"before the first": 0.0, "after 2 cycles": 2.0, "after 5 cycles": 5.0, "after 15 cycles": 15.0}
BETTER = 0.5
"""Maximum error with the diagnosed rig, as a share of the error with the nominal rig."""
HELD = 0.8
RESISTANCE = "flow_resistance_kPa_s_per_SL"
WORN = 0.01
"""Maximum relative error of the nominal volumes and of the nominal resistances of the two proportional
valves."""

HIDDEN: dict[str, tuple[str, float, float]] = {
    "reservoir_leak": (RESISTANCE, 8_000.0, 40_000.0),
    "cv_leak": (RESISTANCE, 600.0, 6_000.0),
    "compressible_flow": ("critical_pressure_ratio", 0.2, 0.5),
    "reservoir_cooling": ("time_constant_s", 4.0, 20.0),
    "cv_heating": ("time_constant_s", 0.5, 8.0),
    "cv_compliance": ("per_kPa", 0.002, 0.015),
    "dead_volume": ("volume_L", 0.08, 0.4),
    "reservoir_volume": ("scale", 0.05, 0.25),
    "evp_restriction": ("scale", 0.08, 0.4),
    "evp_dead_zone": ("opening", 0.1, 0.45),
    "evp_hysteresis": ("width", 0.05, 0.2),
    "evp_lag": ("time_constant_s", 0.005, 0.06),
    "line_delay": ("delay_s", 0.01, 0.09),
    "solenoid_slow_close": ("delay_s", 0.01, 0.08),
    "cv_sensor_lag": ("time_constant_s", 0.01, 0.08),
    "cv_sensor_offset": ("offset_kPa", 0.6, 4.0),
    "cv_sensor_gain": ("gain", 0.02, 0.08),
    "reservoir_sensor_offset": ("offset_kPa", 5.0, 25.0),
    "reservoir_sensor_gain": ("gain", 0.02, 0.08),
}
"""By name: the parameter and its range. A scale or a gain is relative to 1, a dead volume is a share of the
control volume. Two causes are left out: a climb, which belongs to the flight, and `venturi_stall`, which ends
most of these flights before thirty cycles."""
CHOKED = "compressible_flow"
"""The flow of real valves."""
EITHER_SIGN = ("offset_kPa", "gain", "scale")


RECORDED = """
[[runs]]
kind = "steps"
reservoir_kPa = 450
pressures_kPa = [50, 20, 60, 7]
hold_s = 4
[[runs]]
kind = "prbs"
reservoir_kPa = 450
duration_s = 16
levels_opening = [0, 0.15, 0.3, 0.5, 0.75, 1]
min_hold_s = 0.1
max_hold_s = 0.8
vent_share = 0.2
most_kPa = 60
[[runs]]
kind = "bends"
reservoir_kPa = 690
bend_kPa = 20.7
hold_s = 1
rest_s = 1
cycles = 7
[[runs]]
kind = "openings"
name = "hold"
reservoir_kPa = 645
valves = [{ for_s = 3, evp = 0.5, until_kPa = 30 }, { for_s = 13 }]
"""


@dataclass(frozen=True)
class Rigged:
    """A rig with hidden causes, and the flight that it will make."""

    believed: Rig
    actual: TrueRig
    flight: Case


def draw(seed: int) -> Rigged:
    """One rig with up to two causes; the same seed gives the same rig. In half of the rigs, one cause is
    choked flow."""
    dice = random.Random(f"calibrated {seed}")
    believed = Rig(
        reservoir=Reservoir(dice.choice((1.0, 1.5, 2.0))),
        cv=ControlVolume(round(log_uniform(dice, 0.1, 0.4), 3)),
        evp=Evp(round(dice.uniform(1500.0, 2500.0))),
        dvp=Dvp(round(dice.uniform(500.0, 800.0))),
        solenoid=Solenoid(round(dice.uniform(45.0, 90.0))),
    )
    names = dice.sample(sorted(HIDDEN.keys() - {CHOKED}), dice.choices((0, 1, 2), (0.15, 0.6, 0.25))[0])
    if dice.random() < 0.5:
        names = [CHOKED, *names[:1]]
    actual = TrueRig(_worn(dice, believed), {name: _strength(dice, name, believed) for name in names})
    swing_kPa = dice.uniform(12.0, 24.0)
    pneumatics = PneumaticsConfig(cycle_swing_kPa=swing_kPa, cycle_rate_kPa_per_s=dice.uniform(15.0, 30.0))
    setup = actual.setup
    rise_s = swing_kPa / pneumatics.cycle_rate_kPa_per_s
    hold_s, rest_s = TOP_SHARE * rise_s, dice.uniform(0.1, 0.4) * rise_s
    bend = Manoeuvre(0.0, swing_kPa, pneumatics.cycle_rate_kPa_per_s, hold_s, rest_s)
    return Rigged(
        believed,
        actual,
        Case(
            kind="+".join(names) or "none",
            believed=pneumatics,
            plant=setup.plant,
            cv_sensor=setup.cv_sensor,
            reservoir_sensor=setup.reservoir_sensor,
            tuning={},
            fill_kPa=dice.uniform(450.0, 690.0),
            waits_s=dice.uniform(2.0, 5.0),
            program=(bend,),
            seed=seed,
        ),
    )


def _worn(dice: random.Random, rig: Rig) -> Rig:
    assert rig.cv is not None
    off = [1.0 + dice.uniform(-WORN, WORN) for _ in range(4)]
    return replace(
        rig,
        reservoir=Reservoir(rig.reservoir.volume_L * off[0]),
        cv=ControlVolume(rig.cv.volume_L * off[1]),
        evp=Evp(rig.evp.flow_resistance_kPa_s_per_SL * off[2]),
        dvp=Dvp(rig.dvp.flow_resistance_kPa_s_per_SL * off[3]),
    )


def _strength(dice: random.Random, name: str, rig: Rig) -> dict[str, float]:
    parameter, low, high = HIDDEN[name]
    size = log_uniform(dice, low, high)
    if parameter in EITHER_SIGN:
        size *= dice.choice((-1.0, 1.0))
    if parameter == "volume_L" and rig.cv is not None:
        size *= rig.cv.volume_L
    return {parameter: 1.0 + size if parameter in ("gain", "scale") else size}


@dataclass(frozen=True)
class Outcome:
    """The result of one rig: hidden causes, named causes, and the predictions of both estimates."""

    seed: int
    hidden: str
    named: str
    total_cycles: float
    believed: tuple[Guess, ...]
    extended: tuple[Guess, ...]


def judge(seed: int) -> Outcome | None:
    """Diagnose and fly one rig. None if a filling gives too few cycles, or if the flight is too long."""
    rigged = draw(seed)
    flight = fly(rigged.flight)
    if flight is None or flight.total_cycles < FEWEST_CYCLES:
        return None
    extended, named = diagnosed(rigged)
    priors = [prior_of(rigged.flight.believed, rig) for rig in (TrueRig(rigged.believed), extended)]
    readers = [TelemetryReader(prior) for prior in priors]
    estimates = [ReservoirEstimate(prior) for prior in priors]
    guesses: tuple[list[Guess], list[Guess]] = ([], [])
    moments = [began(flight, cycles) for cycles in MOMENTS.values()]
    for t, telemetry in telemetry_messages(flight.telemetry):
        for reader, estimate in zip(readers, estimates, strict=True):
            estimate.update(reader.read(t, telemetry))
        if t < flight.begins_s[moments[len(guesses[0])]]:
            continue
        truth = flight.total_cycles - float(flight.cycles[moments[len(guesses[0])]])
        for estimate, prior, said in zip(estimates, priors, guesses, strict=True):
            left = estimate.cycles_left()
            assert left is not None
            said.append(Guess(truth, left, by_paper(prior.pneumatics, estimate.reservoir_kPa)))
        if len(guesses[0]) == len(moments):
            break
    hidden = rigged.flight.kind
    return Outcome(seed, hidden, named, flight.total_cycles, tuple(guesses[0]), tuple(guesses[1]))


def diagnosed(rigged: Rigged) -> tuple[TrueRig, str]:
    """The rig of the diagnosis, read from its file, and the named causes."""
    runs = simulate_scenario(rigged.actual, parse_scenario(RECORDED, "a minute"), seed=rigged.flight.seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_case(runs, true_rig_text(TrueRig(rigged.believed)).encode(), folder / "case")
        case = read_case(folder / "case")
        verdict = diagnose(case)
        file = folder / "extended.toml"
        file.write_text(true_rig_text(extended_rig(case.rig, verdict)), encoding="utf-8")
        return load_true_rig(file), "+".join([verdict.cause, *(named.cause for named in verdict.also)])


def table_of(found: Sequence[Outcome]) -> Table:
    table = Table("", "rig", "rigs", "median error", "signed", "within 15 %", "within 7 %", "interval holds")
    for index, moment in enumerate(MOMENTS):
        for rig in ("believed", "extended"):
            guesses: list[Guess] = [getattr(outcome, rig)[index] for outcome in found]
            numbers = quantity(guesses, [guess.error for guess in guesses])
            table.add_row(moment, rig, *numbers, f"{fmean(guess.held for guess in guesses):.1%}")
        for rig in ("believed", "extended"):
            guesses = [getattr(outcome, rig)[index] for outcome in found]
            numbers = quantity(guesses, [guess.formula_error for guess in guesses])
            table.add_row(moment, f"Eq. 8, {rig}", *numbers, "", end_section=rig == "extended")
    return table


def summary(found: Sequence[Outcome]) -> str:
    named = sum(set(outcome.hidden.split("+")) == set(outcome.named.split("+")) for outcome in found)
    totals = [outcome.total_cycles for outcome in found]
    return (
        f"{len(found)} rigs with hidden causes, in {named} of which the diagnosis names just these. A "
        f"filling gives {min(totals):.0f} to {max(totals):.0f} cycles, in the median {median(totals):.0f}."
    )


def tell(outcome: Outcome) -> str:
    """One line for a rig, with a mark where the interval does not contain the truth."""
    pairs = zip(outcome.believed, outcome.extended, strict=True)
    said = " | ".join(
        " ".join(f"{guess.error:+7.1%}{' ' if guess.held else '!'}" for guess in pair) for pair in pairs
    )
    return f"{outcome.seed:6d} {said} | {outcome.total_cycles:.0f}: {outcome.hidden} -> {outcome.named}"


def missed_goals(found: Sequence[Outcome]) -> list[str]:
    """One line for each missed goal."""
    missed = []
    for index, moment in enumerate(MOMENTS):
        error = median(abs(outcome.extended[index].error) for outcome in found)
        before = median(abs(outcome.believed[index].error) for outcome in found)
        if error > BETTER * before:
            missed.append(f"{moment}, diagnosed rigs: {error:.1%}, undiagnosed {before:.1%}")
        held = fmean(outcome.extended[index].held for outcome in found)
        if held < HELD:
            missed.append(f"{moment}, diagnosed rigs: the interval contains the truth in {held:.1%}")
    return missed

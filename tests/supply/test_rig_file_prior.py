"""The prior of a diagnosed rig: the effect of its causes on the air, and how it improves the cycles left."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from command_line import status as command
from plant_telemetry import telemetry_of

from firmware_link.protocol import Telemetry
from flying_vines.config import config
from flying_vines.config.config import PneumaticsConfig
from flying_vines.identification.case import read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.verdict import extended_rig
from flying_vines.physics.effects import catalogue
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.plant import at_rest
from flying_vines.physics.plant.true_rig import TrueRig, load_true_rig, true_rig_text
from flying_vines.physics.plant.volume import Pouch, Wall
from flying_vines.physics.rig import ControlVolume, Reservoir, Rig, RigError
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop
from flying_vines.simulation.scenario import parse_scenario, simulate_scenario, write_case
from flying_vines.simulation.simulated_world import SimulatedWorld
from flying_vines.supply import ReservoirEstimate, RigPrior, TelemetryReader, nominal
from flying_vines.supply.rig_file_prior import load_rig_file_prior, prior_of

P = PneumaticsConfig()
RIG = Rig(Reservoir(2.0), ControlVolume(0.1))
RESISTANCE = "flow_resistance_kPa_s_per_SL"


def known(causes: dict[str, dict[str, float]] | None = None, effects: Effects | None = None) -> RigPrior:
    """The prior for a fully diagnosed rig: it has these causes and effects, and no others."""
    return prior_of(P, TrueRig(RIG, causes or {}, effects or Effects(), none_found=not causes))


def test_a_rig_without_causes_is_rigid_tight_and_isothermal() -> None:
    prior = known()
    assert prior.rise.mean == pytest.approx(0.05)
    assert prior.flat.mean == prior.leak.mean == prior.cv_leak.mean == prior.cycle_venturi_s == 0.0
    assert prior.rise.sd < 0.2 * nominal(P).rise.sd
    assert prior.zero_sd_kPa < nominal(P).zero_sd_kPa


def test_a_rig_file_without_a_diagnosis_has_the_priors_of_pneumatics() -> None:
    bigger = Rig(Reservoir(1.5), ControlVolume(0.2))
    numbers = msgspec.structs.replace(P, reservoir_volume_L=1.5, cv_volume_L=0.2)
    assert prior_of(P, TrueRig(bigger)) == nominal(numbers)


@pytest.mark.parametrize(
    ("cause", "parameters", "what", "expected"),
    [
        ("reservoir_leak", {RESISTANCE: 5_000.0}, lambda b: b.leak.mean, 101.325 / 5_000.0 / 2.0),
        ("cv_leak", {RESISTANCE: 300.0}, lambda b: b.cv_leak.mean, 101.325 / 300.0 / 2.0),
        ("dead_volume", {"volume_L": 0.03}, lambda b: b.rise.mean, 0.065),
        ("dead_volume", {"volume_L": 0.03}, lambda b: b.pneumatics.cv_volume_L, 0.13),
        ("cv_compliance", {"per_kPa": 0.01}, lambda b: b.rise.mean, 0.05 * (1 + 0.01 * (101.325 + 20.7))),
        # A slow wall takes no heat during the inflation: 1/γ of the air fills the vine.
        ("cv_heating", {"time_constant_s": 1e6}, lambda b: b.rise.mean, 0.05 / 1.4),
        ("cv_heating", {"time_constant_s": 1e-3}, lambda b: b.rise.mean, 0.05),
        ("reservoir_volume", {"scale": 0.8}, lambda b: b.rise.mean, 0.1 / 1.6),
        ("cv_sensor_gain", {"gain": 1.04}, lambda b: b.rise.mean, 0.05 / 1.04),
        ("cv_sensor_offset", {"offset_kPa": 2.0}, lambda b: b.cycle_rise_kPa, 18.7),
        ("evp_dead_zone", {"opening": 0.4}, lambda b: b.dead_opening, 0.4),
        ("reservoir_cooling", {"time_constant_s": 9.0}, lambda b: b.wall, Wall(9.0)),
        ("reservoir_sensor_offset", {"offset_kPa": 12.0}, lambda b: b.reservoir_kPa(112.0), 100.0),
        ("reservoir_sensor_gain", {"gain": 1.05}, lambda b: b.reservoir_kPa(105.0), 100.0),
        (
            "evp_restriction",
            {"scale": 1.2},
            lambda b: b.evp_law.numbers().conductance_SL_per_s_kPa,
            1.0 / (1.2 * 2042.0),
        ),
    ],
)
def test_the_effect_of_a_cause_on_the_air(
    cause: str, parameters: dict[str, float], what: object, expected: object
) -> None:
    assert callable(what)
    assert what(known({cause: parameters})) == (
        pytest.approx(expected, rel=1e-3) if isinstance(expected, float) else expected
    )


def test_a_pouch_is_filled_from_flat() -> None:
    prior = known(effects=Effects(cv_shape=Pouch(0.02)))
    assert prior.flat.mean == pytest.approx(0.08 * 101.325 / 2.0)
    assert prior.packed_kPa == prior.flat.mean


def test_with_a_slow_outlet_the_venturi_runs() -> None:
    slow = TrueRig(Rig(cv=ControlVolume(0.6)), none_found=True)
    assert known().cycle_venturi_s == 0.0 < prior_of(P, slow).cycle_venturi_s < 0.1


SOME_USED = {
    "cv_leak": {RESISTANCE: 900.0},
    "dead_volume": {"volume_L": 0.02},
    "ambient_drop": {"rate_kPa_per_s": 0.1},
    "venturi_stall": {"supply_pressure_kPa": 400.0},
}


def test_it_lists_used_and_unused_causes(tmp_path: Path) -> None:
    file = tmp_path / "extended.toml"
    file.write_text(true_rig_text(TrueRig(RIG, SOME_USED)))
    calibration = load_rig_file_prior(file, P)
    assert calibration.used == ("cv_leak", "dead_volume")
    assert calibration.unused == ("ambient_drop", "venturi_stall")
    assert "0.12 L" in calibration.summary and "cv_leak, dead_volume" in calibration.summary
    file.write_text(true_rig_text(TrueRig(RIG, none_found=True)))
    assert load_rig_file_prior(file, P).prior == known()


def test_a_rig_without_a_control_volume_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "discharge.toml"
    file.write_text("[reservoir]\nvolume_L = 2\n")
    with pytest.raises(RigError, match=r"discharge\.toml: .*no \[cv\]"):
        load_rig_file_prior(file, P)


# The cycles left in flight.

TOP_KPA = 20.7
RISE_S = TOP_KPA / P.cycle_rate_kPa_per_s
CYCLE_S = 2.5 * RISE_S
WAIT_S = 2.0
FULL_KPA = 500.0


def cycles(there: TrueRig, seconds: float) -> Iterator[tuple[float, Telemetry]]:
    """Telemetry of repeated cycles of `[pneumatics]`, with a short rest after each."""
    times = np.arange(WAIT_S, seconds, 0.02).tolist()
    setpoints = []
    for t in times:
        phase = ((t + 0.02 - WAIT_S) % CYCLE_S) / RISE_S
        share = max(0.0, min(1.0, phase, 2.2 - phase))
        setpoints.append(SetpointChange(t, TOP_KPA * share, P.cycle_rate_kPa_per_s))
    setup = there.setup
    run = closed_loop(
        setup.plant,
        setpoints,
        seconds,
        at_rest(setup.plant, FULL_KPA),
        cv_sensor=setup.cv_sensor,
        reservoir_sensor=setup.reservoir_sensor,
        seed=1,
    )
    return telemetry_of(run)


def errors(there: TrueRig, priors: tuple[RigPrior, ...]) -> list[tuple[float, ...]]:
    """|ln(predicted / true cycles left)| for each prior: before the first cycle, and after five."""
    readers = [TelemetryReader(prior) for prior in priors]
    estimates = [ReservoirEstimate(prior) for prior in priors]
    predicted: dict[int, list[float]] = {}
    best_kPa, missed, cycle = 0.0, 0, -1
    for t, telemetry in cycles(there, 600.0):
        if t >= WAIT_S + (cycle + 1) * CYCLE_S - 1e-6:
            if cycle >= 0:
                missed = missed + 1 if best_kPa < TOP_KPA - 2.07 else 0
            cycle, best_kPa = cycle + 1, 0.0
            if missed == 3:
                break
            if cycle in (0, 5):
                found = [estimate.cycles_left() for estimate in estimates]
                predicted[cycle] = [left.expected for left in found if left]
        best_kPa = max(best_kPa, telemetry.cv_kPa)
        for reader, estimate in zip(readers, estimates, strict=True) if cycle < 5 else ():
            estimate.update(reader.read(t, telemetry))
    assert missed == 3, "the reservoir lasted too long for this test"
    total = cycle - missed
    assert total > 25
    return [tuple(abs(math.log(n / (total - cycle))) for n in left) for cycle, left in predicted.items()]


HIDDEN = {
    "leak-and-lag": {"cv_leak": {RESISTANCE: 1_200.0}, "evp_lag": {"time_constant_s": 0.02}},
    "sensor-and-volume": {"reservoir_sensor_offset": {"offset_kPa": 18.0}, "dead_volume": {"volume_L": 0.06}},
}
BELIEVED = replace(RIG, reservoir=Reservoir(1.0), cv=ControlVolume(0.2))


@pytest.mark.parametrize("causes", HIDDEN.values(), ids=HIDDEN)
def test_a_known_rig_gives_right_cycles_from_the_start(causes: dict[str, dict[str, float]]) -> None:
    there = TrueRig(BELIEVED, causes)
    before, after = errors(there, (prior_of(P, TrueRig(BELIEVED)), prior_of(P, there)))
    assert before[1] < 0.12 and before[0] > 0.5
    assert after[1] < 0.08 and after[0] > 2.0 * after[1]


SCENARIO = """
[[runs]]
kind = "steps"
reservoir_kPa = 450
pressures_kPa = [40, 15, 30, 0]
hold_s = 4
[[runs]]
kind = "openings"
reservoir_kPa = 450
valves = [{ for_s = 3, evp = 0.5, until_kPa = 40 }, { for_s = 9 }]
"""
SUSPECTS = ("cv_leak", "dead_volume", "evp_lag")


@pytest.mark.long
def test_a_diagnosis_improves_the_prediction_of_the_next_flight(tmp_path: Path) -> None:
    there = TrueRig(BELIEVED, {"cv_leak": {RESISTANCE: 800.0}})
    runs = simulate_scenario(there, parse_scenario(SCENARIO, "short"), seed=1)
    write_case(runs, true_rig_text(TrueRig(BELIEVED)).encode(), tmp_path / "case")
    case = read_case(tmp_path / "case")
    verdict = diagnose(case, [cause for cause in catalogue() if cause.name in SUSPECTS])
    (tmp_path / "extended.toml").write_text(true_rig_text(extended_rig(case.rig, verdict)))
    extended = load_true_rig(tmp_path / "extended.toml")
    assert list(extended.causes) == ["cv_leak"]
    before, after = errors(there, (prior_of(P, TrueRig(BELIEVED)), prior_of(P, extended)))
    assert before[1] < 0.15 < 0.5 < before[0]
    assert after[1] < 0.1 < 0.2 < after[0]


# In the service.


def config_file(folder: Path, rig: str) -> Path:
    path = folder / "vine.toml"
    path.write_text(config.default_text().replace('rig = ""', f'rig = "{rig}"'))
    return path


def test_the_rig_is_relative_to_the_configuration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "extended.toml").write_text(true_rig_text(TrueRig(RIG, SOME_USED)))
    assert command("config", "check", config_file(tmp_path, "extended.toml")) == 0
    out = capsys.readouterr().out
    assert "used for cycles left: cv_leak, dead_volume; unused: ambient_drop, venturi_stall" in out


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[cv]\n[causes.cv_leek]\nx = 1\n", "cv_leek"),
        ("[cv]\n[causes.cv_leak]\nflow = 1\n", "causes.cv_leak.flow"),
        ("[cv]\nvolume = 1\n", "cv.volume"),
        ("[reservoir]\nvolume_L = 2\n", "no [cv]"),
        ("[cv", "wrong.toml:1: not TOML"),
    ],
)
def test_an_invalid_rig_is_one_line_and_status_2(
    text: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "wrong.toml"
    rig.write_text(text)
    vine = config_file(tmp_path, "wrong.toml")
    (tmp_path / "other").mkdir()
    other = config_file(tmp_path / "other", "")
    for arguments in (("config", "check", vine), ("run", "--config", other, "--rig", rig)):
        assert command(*arguments) == 2
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert "wrong.toml" in err and says in err


def test_the_core_uses_the_known_rig() -> None:
    there = TrueRig(BELIEVED, {"reservoir_sensor_offset": {"offset_kPa": 30.0}})
    conf = config.default()
    cycles = []
    for prior in (None, prior_of(conf.pneumatics, there)):
        world = SimulatedWorld(conf, prior=prior)
        list(world.advance(2.0))
        left = world.core.snapshot(2.0).cycles
        assert left is not None
        cycles.append(left)
    assert cycles[1].high / cycles[1].low < 0.3 * cycles[0].high / cycles[0].low


def test_reading_a_rig_needs_no_analysis_package(tmp_path: Path) -> None:
    (tmp_path / "extended.toml").write_text(true_rig_text(TrueRig(RIG, SOME_USED)))
    code = (
        "import sys, pathlib\n"
        "from flying_vines.config import config\n"
        "from flying_vines.service import service\n"
        "from flying_vines.terminal import screen\n"
        "from flying_vines.record import recorder\n"
        "from flying_vines.supply.rig_file_prior import load_rig_file_prior\n"
        "load_rig_file_prior(pathlib.Path(sys.argv[1]), config.default().pneumatics)\n"
        "heavy = {'numpy', 'scipy', 'numba', 'matplotlib', 'flying_vines.identification'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "extended.toml")], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")

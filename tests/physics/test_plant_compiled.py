"""The compiled plant gives the same floats as the Simulator in every tick."""

from __future__ import annotations

import dataclasses
import random
import re
import sys
from pathlib import Path

import pytest

from flying_vines.files.extras import install_command
from flying_vines.physics.baseline import Inputs
from flying_vines.physics.effects import catalogue, setup
from flying_vines.physics.gas import Gas
from flying_vines.physics.plant.ambient import Climb, Recorded, Steady
from flying_vines.physics.plant.effects import Effects, likely_effects
from flying_vines.physics.plant.flow import Iso6358, Ohm
from flying_vines.physics.plant.numbers import PlantNumbers, numbers_of
from flying_vines.physics.plant.plant import Conditions, Plant, State, at_rest
from flying_vines.physics.plant.sensors import HONEYWELL_15BAR, HONEYWELL_30PSI, Adc, read, rested
from flying_vines.physics.plant.simulator import SHUT, Simulator
from flying_vines.physics.plant.tick import _MAX_STEP, tick
from flying_vines.physics.plant.valve_response import ValveMotion, dead_zone
from flying_vines.physics.plant.venturi import Ejector
from flying_vines.physics.plant.volume import Compliant, Pouch, Wall
from flying_vines.physics.rig import ControlVolume, Hose, Pump, Reservoir, Rig

np = pytest.importorskip("numpy")
pytest.importorskip("numba")

from flying_vines.physics import compiler  # noqa: E402
from flying_vines.physics.plant import compiled  # noqa: E402
from flying_vines.physics.plant.compiled import CompiledRun, batch, noise_of, replay  # noqa: E402

LIKELY = likely_effects()
ADC = Adc(12)
CV_SENSOR = dataclasses.replace(HONEYWELL_30PSI, adc=ADC, offset_kPa=0.4)
RESERVOIR_SENSOR = dataclasses.replace(HONEYWELL_15BAR, adc=ADC, gain=1.01)

CAUSE_NUMBERS: dict[str, dict[str, float]] = {
    "none": {},
    "reservoir_leak": {"flow_resistance_kPa_s_per_SL": 900.0},
    "cv_leak": {"flow_resistance_kPa_s_per_SL": 300.0},
    "compressible_flow": {"critical_pressure_ratio": 0.4},
    "reservoir_cooling": {"time_constant_s": 6.0},
    "cv_heating": {"time_constant_s": 1.5},
    "cv_compliance": {"per_kPa": 0.01},
    "dead_volume": {"volume_L": 0.05},
    "reservoir_volume": {"scale": 0.9},
    "evp_restriction": {"scale": 1.3},
    "evp_dead_zone": {"opening": 0.3},
    "evp_hysteresis": {"width": 0.2},
    "evp_lag": {"time_constant_s": 0.03},
    "line_delay": {"delay_s": 0.044},
    "solenoid_slow_close": {"delay_s": 0.06},
    "venturi_stall": {"supply_pressure_kPa": 640.0},
    "cv_sensor_lag": {"time_constant_s": 0.02},
    "cv_sensor_offset": {"offset_kPa": 1.5},
    "cv_sensor_gain": {"gain": 1.03},
    "reservoir_sensor_offset": {"offset_kPa": -12.0},
    "reservoir_sensor_gain": {"gain": 0.97},
    "ambient_drop": {"rate_kPa_per_s": 0.3},
    "hose": {"flow_resistance_kPa_s_per_SL": 30.0, "volume_L": 0.05},
    "pump_flow": {"scale": 1.2},
    "pump_stall": {"scale": 0.8},
    "pump_curve": {"critical_pressure_ratio": 0.25},
    "choked_outlet": {"critical_pressure_ratio": 0.4},
    "evp_heating": {"share": 0.3, "time_constant_s": 2.0},
    "cv_sensor_drift": {"rate_kPa_per_min": 4.0},
    "reservoir_sensor_drift": {"rate_kPa_per_min": -20.0},
    "viscous_leak": {"conductance_constant_kPa2_s_per_SL": 7e4},
    "reservoir_viscous_leak": {"conductance_constant_kPa2_s_per_SL": 8e5},
    "orifice_leak": {"sonic_conductance_SL_per_s_kPa": 5e-4},
    "reservoir_orifice_leak": {"sonic_conductance_SL_per_s_kPa": 1e-3},
}


def drawn_inputs(ticks: int, seed: int) -> list[Inputs]:
    """Inflate, trim, hold, vent passively and with the Venturi."""
    rng = random.Random(seed)
    inputs: list[Inputs] = []
    while len(inputs) < ticks:
        command = rng.choice(
            [
                Inputs(1.0, 0.0, False),
                Inputs(rng.uniform(0.3, 0.9), 0.0, False),
                SHUT,
                Inputs(0.0, 0.0, True),
                Inputs(0.0, rng.choice([0.6, 1.0]), True),
            ]
        )
        inputs += [command] * rng.randrange(5, 80)
    return inputs[:ticks]


def differs_kPa(run: CompiledRun, plant: Plant, inputs: list[Inputs], state: State | None = None) -> float:
    """The largest difference of any state from the Simulator's, at every tick and at the end."""
    simulator = Simulator(plant, state)
    rows = []
    for command in inputs:
        rows.append([*simulator.conditions, simulator.state.vented_SL, *simulator.state[7:9]])
        simulator.advance(command)
    columns = [*simulator.conditions._fields, "vented_SL", "evp_opening", "dvp_opening"]
    found = np.column_stack([run.table[name] for name in columns])
    assert found.shape == (len(inputs), 11)
    assert np.isfinite(found).all()
    at_the_end = np.abs(np.array(run.state) - np.array(simulator.state)).max()
    return float(max(np.abs(found - np.array(rows)).max(), at_the_end))


PLANTS = {
    "baseline": Plant(),
    "likely": Plant(Rig(), LIKELY),
    "rigid": Plant(Rig(cv=ControlVolume(0.5)), likely_effects(pouch=False)),
    "without a control volume": Plant(Rig(cv=None), LIKELY),
    "compliant, no tube": Plant(Rig(), dataclasses.replace(LIKELY, tubing=None, cv_shape=Compliant(0.01))),
    "isothermal pouch, Ohm": Plant(Rig(), Effects(cv_shape=Pouch(), ejector=Ejector(300.0, None, 0.6))),
    "walls by time constants": Plant(Rig(), Effects(reservoir_wall=Wall(8.0), cv_wall=Wall(0.5))),
    "cracking and bent laws": Plant(
        Rig(),
        dataclasses.replace(
            LIKELY,
            solenoid_law=Iso6358(3e-3, 0.2, 0.6, 2.0),
            cv_leak=Iso6358(1e-4),
            reservoir_leak=Ohm(500.0),
        ),
    ),
    "one way": Plant(Rig(), dataclasses.replace(LIKELY, evp_law=Iso6358(5e-4, one_way=True))),
    "pump": Plant(
        Rig(pump=Pump(), hose=Hose()),
        Effects(cv_wall=Wall(0.5), evp_motion=ValveMotion(0.01, 0.1, 0.1, 0.03)),
    ),
    "helium": Plant(Rig(gas=Gas("He")), LIKELY),
    "thin air": Plant(Rig(), dataclasses.replace(LIKELY, ambient=Steady(70.0, 260.0))),
    "climbing": Plant(Rig(), dataclasses.replace(LIKELY, ambient=Climb(0.5))),
    "weather": Plant(
        Rig(),
        dataclasses.replace(
            LIKELY, ambient=Recorded((0.1, 0.3505, 0.9), (101.0, 100.0, 104.0), (290.0, 280.0, 300.0))
        ),
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", PLANTS)
def test_a_replay_is_the_simulators_run(name: str) -> None:
    plant, inputs = PLANTS[name], drawn_inputs(1500, 4)
    worst = differs_kPa(replay(plant, inputs), plant, inputs)
    print(f"{name}: {worst:.1e}")
    assert worst < 1e-9


@pytest.mark.parametrize("cause", [cause.name for cause in catalogue()])
def test_every_cause_is_the_simulators_and_so_are_its_readings(cause: str) -> None:
    made, inputs = setup(Rig(), cause, **CAUSE_NUMBERS[cause]), drawn_inputs(600, 8)
    run = replay(made.plant, inputs, cv_sensor=made.cv_sensor, reservoir_sensor=made.reservoir_sensor, seed=5)
    assert differs_kPa(run, made.plant, inputs) < 1e-9
    noise = noise_of(5, len(inputs))
    for sensor, true, readings, column in (
        (made.cv_sensor, "line_kPa", "cv_reading_kPa", 0),
        (made.reservoir_sensor, "reservoir_kPa", "reservoir_reading_kPa", 1),
    ):
        seen = rested(run.table[true][0])
        for row, kPa in enumerate(run.table[true]):
            seen, expected = read(sensor, seen, kPa, 0.001, noise[row, column])
            assert run.table[readings][row] == pytest.approx(expected, abs=1e-9)


def random_plant(seed: int) -> Plant:
    """Any rig, fast or slow, with or without jumps."""
    rng = random.Random(seed)
    volume_L = 10.0 ** rng.uniform(-1.3, 0.3)

    def iso(conductance: float) -> Iso6358:
        return Iso6358(conductance * rng.uniform(0.4, 2.5), rng.uniform(0.0, 0.6), rng.choice([0.5, 0.6]))

    effects = Effects(
        evp_law=rng.choice([None, iso(5e-4)]),
        dvp_law=iso(1.4e-3),
        solenoid_law=rng.choice([None, iso(3.6e-3)]),
        ejector=rng.choice([None, Ejector(300.0), Ejector(0.0, 1.2e-3, 0.6)]),
        reservoir_wall=rng.choice([None, Wall(rng.uniform(0.1, 20.0))]),
        cv_wall=rng.choice([None, Wall(rng.uniform(0.05, 5.0)), LIKELY.cv_wall]),
        evp_motion=rng.choice([None, LIKELY.evp_motion, ValveMotion(time_constant_s=0.003)]),
        tubing=rng.choice([None, Hose(rng.uniform(0.003, 0.03), rng.uniform(2.0, 30.0))]),
        cv_shape=rng.choice([None, Compliant(0.01), Pouch(volume_L * rng.uniform(0.02, 0.5), 0.002)]),
        cv_leak=rng.choice([None, Ohm(200.0)]),
    )
    return Plant(Rig(Reservoir(rng.uniform(0.3, 4.0)), ControlVolume(volume_L)), effects)


def test_finer_steps_change_little_whatever_the_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    worst = []
    for seed in range(60):
        plant, inputs = random_plant(seed), drawn_inputs(1000, seed)
        usual = replay(plant, inputs).table
        with monkeypatch.context() as patch:
            patch.setattr(compiled, "numbers_of", finer)
            fine = replay(plant, inputs).table
        worst.append(max(np.abs(usual[name] - fine[name]).max() for name in Conditions._fields[:3]))
    print(f"median {np.median(worst):.1e}, largest {max(worst):.1e} kPa")
    # The worst case: a flat pouch of 7 mL that returns from a vacuum in three ticks.
    assert max(worst) < 0.1
    assert np.quantile(worst, 0.95) < 0.01
    assert np.median(worst) < 1e-3


def finer(plant: Plant, tick_s: float) -> PlantNumbers:
    return numbers_of(plant, tick_s)._replace(standing_per_s=40.0 * _MAX_STEP / tick_s)


def test_it_starts_in_the_given_state_and_writes_at_the_given_interval() -> None:
    plant = Plant(Rig(), dataclasses.replace(LIKELY, evp_motion=ValveMotion(delay_s=0.02)))
    state = at_rest(plant, 300.0, 15.0)
    inputs = drawn_inputs(501, 2)
    every = replay(plant, inputs, state)
    assert differs_kPa(every, plant, inputs, state) < 1e-9
    some = replay(plant, inputs, state, record_every=10)
    assert len(some.table) == 51
    for name in ("time_s", "evp", "cv_kPa", "reservoir_reading_kPa"):
        assert (some.table[name] == every.table[name][::10]).all()
    assert some.state == every.state
    before = replay(plant, [SHUT] * 100, state, initial=Inputs(1.0, 0.0, False)).table["evp_opening"]
    assert before[:22].tolist() == [0.0] + [1.0] * 20 + [0.0]


def test_half_a_run_and_the_other_half_are_the_run() -> None:
    """For a plant without memory except its state."""
    inputs = drawn_inputs(400, 3)
    whole = replay(PLANTS["walls by time constants"], inputs)
    half = replay(PLANTS["walls by time constants"], inputs[:200])
    other = replay(PLANTS["walls by time constants"], inputs[200:], half.state)
    assert other.table["cv_kPa"] == pytest.approx(whole.table["cv_kPa"][200:], abs=1e-9)


def test_noise_is_the_seeds_and_readings_are_the_converters_codes() -> None:
    def run(seed: int | None) -> CompiledRun:
        return replay(
            PLANTS["likely"],
            [SHUT] * 3000,
            cv_sensor=CV_SENSOR,
            reservoir_sensor=RESERVOIR_SENSOR,
            seed=seed,
        )

    first, again, other, quiet = run(1), run(1), run(2), run(None)
    assert (first.table["cv_reading_kPa"] == again.table["cv_reading_kPa"]).all()
    assert (first.table["cv_reading_kPa"] != other.table["cv_reading_kPa"]).any()
    noise = first.table["reservoir_reading_kPa"] - 1.01 * first.table["reservoir_kPa"]
    assert noise.std() == pytest.approx(1.2, rel=0.1)
    assert quiet.table["cv_reading_kPa"][0] == pytest.approx(0.4, abs=ADC.step_kPa(206.84) / 2.0)
    codes = (first.table["cv_reading_kPa"] / ADC.step_kPa(206.84)) % 1.0
    assert np.ptp(codes) < 1e-6


def test_a_batch_is_its_runs() -> None:
    inputs = drawn_inputs(300, 6)
    effects = likely_effects(pouch=False)
    plants = [Plant(Rig(cv=ControlVolume(volume_L)), effects) for volume_L in (0.05, 0.1, 0.2, 0.5)]
    singles = [replay(plant, inputs) for plant in plants]
    for threads in (1, 3):
        for single, one in zip(
            singles, batch(lambda plant: replay(plant, inputs), plants, threads=threads), strict=True
        ):
            assert (one.table["cv_kPa"] == single.table["cv_kPa"]).all()
            assert one.state == single.state
    assert len({single.state for single in singles}) == len(plants)


def test_what_cannot_be_replayed() -> None:
    with pytest.raises(ValueError, match="3 columns"):
        replay(Plant(), [(0.0, 1.0)])
    with pytest.raises(ValueError, match="record_every must be"):
        replay(Plant(), [SHUT], record_every=0)


def test_compiled_code_is_cached_under_a_digest_of_its_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiler.compiled.__wrapped__(dead_zone)(0.65, 0.3) == dead_zone(0.65, 0.3)
    (folder,) = (tmp_path / "flying-vines").iterdir()
    assert list(folder.rglob("*.nbi"))
    assert compiler._cache_folder(dead_zone) == folder
    assert compiler._cache_folder(tick) != folder
    # A constant of a called function is a part of the cache key.
    before = compiler._cache_folder(tick)
    monkeypatch.setattr("flying_vines.physics.plant.volume._PER_K", 0.0)
    assert compiler._cache_folder(tick) != before
    # So is the name of a module: cached code of a renamed module cannot be loaded.
    monkeypatch.setattr(dead_zone, "__module__", "flying_vines.physics.plant.motion")
    assert compiler._cache_folder(dead_zone) != folder


def test_without_a_cache_it_is_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert compiler.compiled.__wrapped__(dead_zone)(0.65, 0.3) == dead_zone(0.65, 0.3)


def test_without_numba_it_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.raises(compiler.NoCompiler, match=re.escape(install_command("analysis"))):
        compiler.compiled.__wrapped__(dead_zone)

"""The compiled closed loop gives the same floats as the regulator on the `Simulator`."""

from __future__ import annotations

import dataclasses
import math

import pytest

from firmware_link.protocol import PROTOCOL_VERSION, Codec, Hello
from firmware_link.protocol import Setpoint as SetpointMessage
from flying_vines.physics.baseline import Inputs
from flying_vines.physics.plant.ambient import Climb
from flying_vines.physics.plant.effects import Effects, likely_effects
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.sensors import HONEYWELL_15BAR, HONEYWELL_30PSI, Adc, read, rested
from flying_vines.physics.plant.simulator import Simulator
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.firmware import SAFE, Regulator
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar

np = pytest.importorskip("numpy")
pytest.importorskip("numba")

from flying_vines.physics.plant.compiled import batch, noise_of  # noqa: E402
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop  # noqa: E402

CV_SENSOR = dataclasses.replace(HONEYWELL_30PSI, adc=Adc(12))
RESERVOIR_SENSOR = dataclasses.replace(HONEYWELL_15BAR, adc=Adc(10))
SETPOINTS = [
    SetpointChange(0.02, 12.0, 60.0),
    SetpointChange(0.5, 5.0, 25.0),
    SetpointChange(0.9, math.nan, 0.0),
    SetpointChange(1.1, 15.0, 200.0),
    SetpointChange(1.4, 0.0, 150.0),
]
PLANTS = {
    "baseline": Plant(Rig(), Effects()),
    "likely": Plant(Rig(), likely_effects()),
    "rigid, climbing": Plant(
        Rig(cv=ControlVolume(0.3)), dataclasses.replace(likely_effects(pouch=False), ambient=Climb(0.3))
    ),
}


@pytest.mark.parametrize("name", PLANTS)
def test_it_is_the_regulator_on_the_simulator(name: str) -> None:
    plant, seed = PLANTS[name], 3
    start = at_rest(plant, 500.0, 3.0)
    run = closed_loop(
        plant, SETPOINTS, 1.8, start, cv_sensor=CV_SENSOR,
        reservoir_sensor=RESERVOIR_SENSOR, seed=seed, record_every=1,
    )  # fmt: skip
    simulator = Simulator(plant, start)
    regulator: Regulator | None = None
    noise = noise_of(seed, 1800)
    cv_seen = rested(simulator.conditions.line_kPa)
    reservoir_seen = rested(simulator.conditions.reservoir_kPa)
    rows = []
    cv_kPa = math.nan
    for tick in range(1800):
        cv_before_kPa = cv_kPa
        true = simulator.conditions
        cv_seen, cv_kPa = read(CV_SENSOR, cv_seen, true.line_kPa, 0.001, noise[tick, 0])
        reservoir_seen, reservoir_kPa = read(
            RESERVOIR_SENSOR, reservoir_seen, true.reservoir_kPa, 0.001, noise[tick, 1]
        )
        due = [order for order in SETPOINTS if round(order.from_s * 1000) <= tick]
        if not due or math.isnan(due[-1].target_kPa):
            regulator = None
        else:
            regulator = regulator or Regulator(cv_kPa=cv_before_kPa)
        drive = SAFE
        if regulator is not None:
            drive = regulator.step(due[-1].target_kPa, due[-1].rate_kPa_per_s, cv_kPa, reservoir_kPa)
        rows.append((cv_kPa, reservoir_kPa, *drive, *true, simulator.state.vented_SL))
        simulator.advance(Inputs(*drive))
    columns = [
        "cv_reading_kPa",
        "reservoir_reading_kPa",
        "evp",
        "dvp",
        "solenoid",
        *true._fields,
        "vented_SL",
    ]
    found = np.column_stack([run.table[column] for column in columns])
    assert np.abs(found - np.array(rows, float)).max() < 1e-9
    assert np.abs(np.array(run.state) - np.array(simulator.state)).max() < 1e-9
    assert run.table["cv_kPa"].max() > 8.0


def test_it_holds_what_the_whole_firmware_holds() -> None:
    """On the same rig, the firmware has frames, telemetry, a converter and single precision."""
    run = closed_loop(PLANTS["baseline"], [SetpointChange(0.1, 12.0, 60.0)], 1.5, record_every=1)
    phlosar = SimulatedPhlosar(TrueRig(Rig()))
    host, pressures = Codec(), []
    phlosar.receive(host.encode(Hello(PROTOCOL_VERSION, 7)))
    for tick in range(1500):
        if tick >= 100:
            phlosar.receive(host.encode(SetpointMessage(12.0, 60.0, 250, tick)))
        pressures.append(phlosar.cv_kPa)
        host.decode(phlosar.advance((tick + 1) / 1000))
    apart_kPa = np.abs(run.table["cv_kPa"] - np.array(pressures))
    # They may differ by one puff.
    assert apart_kPa.max() < 0.8
    assert apart_kPa[-500:].max() < 0.3


def test_the_table_has_the_requested_and_the_held_setpoint() -> None:
    table = closed_loop(PLANTS["baseline"], SETPOINTS, 1.8).table
    assert len(table) == 180
    assert np.diff(table["time_s"]) == pytest.approx(0.01)
    assert np.isnan(table["target_kPa"][:2]).all()
    assert np.isnan(table["setpoint_kPa"][90:110]).all()
    assert (table["solenoid"][90:110] == 1.0).all()
    # Rising from 0 at 60 kPa/s: 10 ms after the start.
    assert table["setpoint_kPa"][3] == pytest.approx(0.66, abs=0.07)
    assert table["setpoint_kPa"][45] == 12.0
    assert table["cv_kPa"][45] == pytest.approx(12.0, abs=0.5)


def test_a_batch_on_two_cores_is_its_runs() -> None:
    def run(seed: int) -> bytes:
        table = closed_loop(
            PLANTS["likely"],
            SETPOINTS,
            0.3,
            cv_sensor=CV_SENSOR,
            reservoir_sensor=RESERVOIR_SENSOR,
            seed=seed,
        ).table
        return bytes(table.tobytes())

    one_by_one = [run(seed) for seed in range(6)]
    assert batch(run, range(6), threads=2) == one_by_one
    assert len(set(one_by_one)) == 6


def test_setpoints_that_go_back_in_time() -> None:
    with pytest.raises(ValueError, match="times of setpoints must increase"):
        closed_loop(PLANTS["baseline"], [SetpointChange(1.0, 5.0, 10.0), SetpointChange(1.0, 6.0, 10.0)], 2.0)

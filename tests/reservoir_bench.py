"""Telemetry of a reservoir with known leak and cooling for the estimate, without the plant."""

from __future__ import annotations

import random
from collections.abc import Callable

from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.config.config import ChecksConfig, PneumaticsConfig
from flying_vines.supply import CyclesLeft, ReservoirEstimate, TelemetryReader, nominal
from flying_vines.supply.physics_checks import CHECKS, PhysicsChecks, ReservoirSensor, expected

DEMONSTRATION = PneumaticsConfig()


class Bench:
    """A reservoir of the demonstration's size, read at 100 Hz by a noisy sensor, without the other parts of
    the plant.

    `cost_kPa` is the reservoir's fall for a rise of the vine by 20.7 kPa; `leak_per_s` is the share of the
    pressure that is lost each second. The gas cools with the outflow: each lost kPa lowers the reading by
    another 0.4 kPa, which comes back with the time constant `recovery_s`.

    `lie` changes a reading of the sensor. `in_doubt` is the finding of the check of the sensor.
    """

    def __init__(
        self,
        cost_kPa: float = 6.1,
        leak_per_s: float = 0.0,
        start_kPa: float = 690.0,
        seed: int = 1,
        pneumatics: PneumaticsConfig = DEMONSTRATION,
    ) -> None:
        prior, limits = nominal(pneumatics), ChecksConfig()
        self.reader = TelemetryReader(prior)
        self.estimate = ReservoirEstimate(prior)
        self.sensor = ReservoirSensor(expected(prior, limits), self.estimate)
        self.checks = PhysicsChecks(prior, limits, CHECKS | {"reservoir_sensor": lambda _: self.sensor})
        self.lie: Callable[[float], float] = lambda reading_kPa: reading_kPa
        self.armed = True
        self.t = 0.0
        self.reservoir_kPa = start_kPa
        self.cold_kPa = 0.0
        self.recovery_s = 12.0
        self.cost_kPa = cost_kPa
        self.venturi_kPa_per_s = 0.0
        self.leak_per_s = leak_per_s
        self._random = random.Random(seed)

    @property
    def in_doubt(self) -> str:
        finding = self.checks.present.get("reservoir_sensor")
        return finding.sentence if finding else ""

    def left(self) -> CyclesLeft:
        left = self.estimate.cycles_left()
        assert left is not None
        return left

    def see(
        self, seconds: float, begin_kPa: float, end_kPa: float, rest_s: float = 0.0, dvp: float = 0.0
    ) -> None:
        """A linear setpoint that the control volume follows; then a rest."""
        steps = round(seconds * 100)
        flow_SL_per_s = self.cost_kPa * abs(end_kPa - begin_kPa) / 20.7 * 2.0 / 101.325 / seconds
        for i in range(steps + round(rest_s * 100)):
            share = min(1.0, (i + 1) / steps)
            setpoint = begin_kPa + (end_kPa - begin_kPa) * share
            rises = i < steps and end_kPa > begin_kPa
            out = self.leak_per_s * self.reservoir_kPa * 0.01
            if rises:
                out += self.cost_kPa * (end_kPa - begin_kPa) / 20.7 / steps
            if i < steps:
                out += dvp * self.venturi_kPa_per_s * 0.01
            self.reservoir_kPa -= out
            self.cold_kPa += 0.4 * out - self.cold_kPa * 0.01 / self.recovery_s
            self.t += 0.01
            effective = flow_SL_per_s / (4.95e-4 * (self.reservoir_kPa + 101.325))
            evp = min(1.0, 0.3 + 0.7 * effective) if rises else 0.0
            self.tell(setpoint, evp, dvp if i < steps else 0.0, setpoint <= 0.0)

    def tell(
        self,
        setpoint_kPa: float = 0.0,
        evp: float = 0.0,
        dvp: float = 0.0,
        solenoid: bool = True,
        reservoir_kPa: float | None = None,
        faults: Fault = Fault.NONE,
        mode: Mode = Mode.REGULATE,
    ) -> None:
        if reservoir_kPa is None:
            reservoir_kPa = self.lie(self._random.gauss(self.reservoir_kPa - self.cold_kPa, 1.2))
        cv_kPa = self._random.gauss(setpoint_kPa, 0.15)
        telemetry = Telemetry(
            round(self.t * 1000),
            mode,
            faults,
            1,
            setpoint_kPa,
            cv_kPa,
            reservoir_kPa,
            evp,
            dvp,
            solenoid,
        )
        features = self.reader.read(self.t, telemetry, self.armed)
        self.estimate.update(features)
        self.checks.take(features)

    def rest(self, seconds: float) -> None:
        self.see(seconds, 0.0, 0.0)

    def bend(self, times: int = 1, top_kPa: float = 20.7, hold_s: float = 1.0, rest_s: float = 1.2) -> None:
        for _ in range(times):
            self.see(0.5, 0.0, top_kPa, hold_s)
            self.see(0.3, top_kPa, 0.0, rest_s)

    def fly(self, times: int) -> CyclesLeft:
        self.rest(3.0)
        self.bend(times + 2)
        return self.left()

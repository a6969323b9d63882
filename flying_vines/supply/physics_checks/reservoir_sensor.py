"""Checks the reservoir's sensor against an account of the air, over the whole flight.

The account is the maximum that a right sensor can read. Each bend lowers it by the air that the bend has
surely used, and each reading lowers it to the air that this reading shows. Only slow warming raises it. So a
reading above the account is wrong, whatever the reason: the sensor is stuck, drifts up, or jumped up.

A cold gas warms up again, and then the reading rises without filling. So a reading shows up to `_Cold` more
air than the reading alone. While the vehicle is disarmed a rise is a refill, and the account starts again.
"""

from __future__ import annotations

import math
from typing import Protocol

from flying_vines.physics.gas import GAMMA, STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.volume import COOLING_K, heat_capacity_J_per_K
from flying_vines.supply.physics_checks.expected import Expected
from flying_vines.supply.reservoir_filter import MAX_WARMTH
from flying_vines.supply.rig_prior import AMBIENT_KPA
from flying_vines.supply.telemetry_features import MAX_BRIDGED_S, Features

STUCK_KPA = 1.5
"""A reading is stuck if it did not change at all while a fall by this much was expected."""
MARGIN_KPA = 2.0
"""Resolution and slow errors of a good sensor. The noise of its mean is added."""
NOISE_SDS = 6.0
"""A block's mean may be this many of its standard deviations off: a flight has thousands of blocks."""
BLOCK_S = 0.5
"""Time of undisturbed readings that are averaged, and that a right sensor needs to be believed again."""
BLOCK_READINGS = 5
CALM_S = 0.3
"""After a flow the pressure at the sensor needs this time."""
WORKING_OPENING = 0.6
"""A regulator holds a bent vine with a smaller opening of its inflation valve."""
ARMED_S = 2.0
"""A rise that began before the vehicle was armed is over after this time."""
WARMS_KPA_PER_S = 0.15
"""Fastest warming without a bend, as in the sun: 0.06 K/s at 700 kPa."""
WARMTH_KPA = 12.0
"""So fast a warming ends after this rise: 4 K at 700 kPa, as in the sun after the shade."""
WARMS_ON_KPA_PER_S = 0.01
"""Warming that goes on, as during a morning: 13 K in an hour."""
BENDS_S = 5.0
"""For this time after a rise of the vine no warming is assumed: the air that is not counted is more."""
RIGHT_S = 5.0
"""A sensor is right again when it has read less than the account for this time."""
VINE_FILTER_S = 0.1
TURN_KPA = 2.0
"""A smaller fall is noise, not a turn."""
RISES = "rises without filling"
STAYS = "does not fall as the vine fills"
MAX_SHARE = 0.9
"""Keeps the steps of the temperatures stable."""


class LearnedUse(Protocol):
    """What the estimate of the cycles left knows of the air."""

    @property
    def sure_use_kPa(self) -> float:
        """The air that all bends so far have surely used. It only grows."""

    @property
    def rose_kPa(self) -> float:
        """A sudden rise of the pressure that is not reported yet."""


class _Cold:
    """How much the gas may be colder than ambient, from the falls of the reading.

    The wall conducts as badly as any reservoir's, so that the gas stays cold for the longest time.
    """

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._gas_K = self._wall_K = 0.0

    def fall(self, fall_kPa: float, dt_s: float, reservoir_kPa: float) -> float:
        """Take in a fall of the reading. Returns the rise that the gas makes as it warms up."""
        kPa_abs = max(1.0, reservoir_kPa + AMBIENT_KPA)
        kPa_per_K = kPa_abs / STANDARD_TEMPERATURE_K
        gas_J_per_K = heat_capacity_J_per_K(kPa_abs, self._rig.reservoir_L)
        rates = self._rig.wall.rates(gas_J_per_K, math.exp(-MAX_WARMTH))
        apart_K = self._gas_K - self._wall_K
        warmer_K = apart_K * min(MAX_SHARE, rates.gas_per_s * dt_s)
        out_kPa = (fall_kPa + warmer_K * kPa_per_K) / GAMMA
        self._gas_K = max(0.0, self._gas_K + COOLING_K / kPa_abs * out_kPa - warmer_K)
        into_wall_K = apart_K * min(MAX_SHARE, rates.wall_per_s * dt_s)
        self._wall_K += into_wall_K - self._wall_K * min(MAX_SHARE, rates.outer_per_s * dt_s)
        return self._gas_K * kPa_per_K


class _Block:
    """The mean of undisturbed readings, and its standard deviation."""

    def __init__(self) -> None:
        self._readings_kPa: list[float] = []
        self._s = 0.0

    def add(self, reservoir_kPa: float, dt_s: float) -> tuple[float, float] | None:
        """Take in a reading. Returns mean and standard deviation when the block is complete."""
        self._s += dt_s
        self._readings_kPa.append(reservoir_kPa)
        count = len(self._readings_kPa)
        if self._s < BLOCK_S - 1e-6 or count < BLOCK_READINGS:
            return None
        mean_kPa = sum(self._readings_kPa) / count
        variance = sum((kPa - mean_kPa) ** 2 for kPa in self._readings_kPa) / count
        self._readings_kPa, self._s = [], 0.0
        return mean_kPa, math.sqrt(variance / count)


class ReservoirSensor:
    """Finds a reservoir's sensor that reads more than the reservoir can have.

    The finding stays until the sensor reads less than the account again, or until a person clears it.
    """

    def __init__(self, rig: Expected, learned: LearnedUse | None = None) -> None:
        self._rig = rig
        self._learned = learned
        self._used_kPa = learned.sure_use_kPa if learned else 0.0
        """The learned use up to the last message."""
        self._cv_kPa = self._top_kPa = math.nan
        self._reading_kPa = math.nan
        self._unchanged_kPa = 0.0
        """Expected fall since the reading last changed."""
        self._calm_s = 0.0
        self._since_rise_s = math.inf
        self._rose_kPa = 0.0
        """The learned rise at the last message."""
        self._armed_s = 0.0
        self._armed = False
        self.found_at = -math.inf
        """When the latest finding began."""
        self._begin()

    def _begin(self) -> None:
        """Believe the next readings."""
        self._cold = _Cold(self._rig)
        self._block = _Block()
        self._block_armed = False
        self._block_at: float | None = None
        self._block_kPa = math.nan
        """Mean of the last block."""
        self._by_volume_kPa = self._by_learned_kPa = self._low_kPa = math.inf
        """The account, less the least air of any vine of this volume; less the learned air; without bends."""
        self._warmth_kPa = WARMTH_KPA
        self._right_s = 0.0
        self._finding: str | None = None

    def clear(self) -> None:
        """A person says that the sensor is right."""
        self._unchanged_kPa = 0.0
        self._begin()

    def look(self, now: Features) -> str | None:
        reservoir_kPa = now.reservoir_kPa
        self._armed_s = self._armed_s + now.device_dt_s if now.armed else 0.0
        armed = self._armed_s > ARMED_S
        if armed and not self._armed and self._finding is None:
            self._begin()  # a slow refill on the ground ends here
        self._armed = armed
        if reservoir_kPa is None:
            return self._finding
        self._spend(now, reservoir_kPa)
        if self._finding is None:
            if self._unchanged_kPa > STUCK_KPA:
                self._find(now.t, f"stuck at {reservoir_kPa:.0f} kPa", reservoir_kPa)
            elif self._rose() and armed and reservoir_kPa > self._most_kPa + MARGIN_KPA:
                self._find(now.t, self._what(reservoir_kPa, MARGIN_KPA), reservoir_kPa)
        self._rose_kPa = self._learned.rose_kPa if self._learned else 0.0
        if self._is_calm(now):
            block = self._block.add(reservoir_kPa, min(now.device_dt_s, MAX_BRIDGED_S))
            if block is not None:
                self._judge(now.t, *block)
        return self._finding

    @property
    def _most_kPa(self) -> float:
        return min(self._by_volume_kPa, self._by_learned_kPa)

    def _spend(self, now: Features, reservoir_kPa: float) -> None:
        """Lower the account by the air that the vine has surely taken."""
        rise_kPa = self._follow_vine(now)
        volume_kPa = self._rig.reservoir_fall_kPa(self._rig.min_air_SL(rise_kPa))
        used_kPa = self._learned.sure_use_kPa if self._learned else 0.0
        self._by_volume_kPa -= volume_kPa
        self._by_learned_kPa -= used_kPa - self._used_kPa
        self._used_kPa = used_kPa
        self._unchanged_kPa = self._unchanged_kPa + volume_kPa if reservoir_kPa == self._reading_kPa else 0.0
        self._reading_kPa = reservoir_kPa
        self._since_rise_s = 0.0 if rise_kPa > 0.0 else self._since_rise_s + now.device_dt_s
        self._warmth_kPa = min(WARMTH_KPA, self._warmth_kPa + WARMS_ON_KPA_PER_S * now.device_dt_s)
        if self._since_rise_s > BENDS_S:
            warmer_kPa = min(self._warmth_kPa, WARMS_KPA_PER_S * now.device_dt_s)
            self._warmth_kPa -= warmer_kPa
            self._by_volume_kPa += warmer_kPa
            self._by_learned_kPa += warmer_kPa
            self._low_kPa += warmer_kPa

    def _follow_vine(self, now: Features) -> float:
        """Take in the vine's pressure. Returns its rise, if the inflation valve may have caused it."""
        if math.isnan(self._cv_kPa):
            self._cv_kPa = self._top_kPa = now.cv_median_kPa
        self._cv_kPa += (now.cv_median_kPa - self._cv_kPa) * min(1.0, now.device_dt_s / VINE_FILTER_S)
        rise_kPa = max(0.0, self._cv_kPa - self._top_kPa)
        self._top_kPa = self._cv_kPa if rise_kPa else min(self._top_kPa, self._cv_kPa + TURN_KPA)
        return rise_kPa if now.max_evp > 0.0 else 0.0

    def _is_calm(self, now: Features) -> bool:
        calm = now.max_dvp == 0.0 and now.max_evp <= WORKING_OPENING
        self._calm_s = self._calm_s + now.device_dt_s if calm else 0.0
        return self._calm_s > CALM_S

    def _judge(self, t: float, kPa: float, sd_kPa: float) -> None:
        dt_s = 0.0 if self._block_at is None else t - self._block_at
        before_kPa = kPa if self._block_at is None else self._block_kPa
        self._block_at, self._block_kPa = t, kPa
        air_kPa = kPa + self._cold.fall(before_kPa - kPa, dt_s, kPa)
        armed = self._block_armed and self._armed
        self._block_armed = self._armed
        margin_kPa = MARGIN_KPA + NOISE_SDS * sd_kPa
        if self._finding is not None:
            self._right_s = self._right_s + BLOCK_S if kPa < self._most_kPa else 0.0
            if self._right_s < RIGHT_S:
                return
            self._finding = None
        elif not armed and kPa > self._low_kPa + margin_kPa:
            self._begin()  # a refill
            return
        elif kPa > self._most_kPa + margin_kPa:
            self._find(t, self._what(kPa, margin_kPa), kPa)
            return
        self._by_volume_kPa = min(self._by_volume_kPa, air_kPa)
        self._by_learned_kPa = min(self._by_learned_kPa, air_kPa)
        self._low_kPa = min(self._low_kPa, air_kPa)

    def _rose(self) -> bool:
        """The estimate has found a sudden rise, which it would report as a refill."""
        return self._learned is not None and self._learned.rose_kPa > self._rose_kPa

    def _what(self, kPa: float, margin_kPa: float) -> str:
        return RISES if kPa > self._low_kPa + margin_kPa else STAYS

    def _find(self, t: float, what: str, kPa: float) -> None:
        self.found_at = t
        self._finding = f"reservoir sensor {what}: cycles unknown"
        self._right_s = 0.0
        # A stuck sensor must not be right again because of its noise.
        least_kPa = min(self._most_kPa, kPa - MARGIN_KPA)
        self._by_volume_kPa = self._by_learned_kPa = least_kPa

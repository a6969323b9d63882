"""Checks that the reservoir loses as much air as the valves take."""

from __future__ import annotations

from collections import deque

from flying_vines.physics.gas import GAMMA
from flying_vines.supply.physics_checks.expected import Expected
from flying_vines.supply.telemetry_features import Features

BLOCK_S = 0.2
"""Averaging time of a reading of the reservoir."""
SPANS_BLOCKS = (5, 20)
"""One second for fast losses, four for slow ones: noise matters less over the longer time."""
MARGIN_KPA = 2.0
"""Margin above the noise of two blocks. A block is never noisier than the mean difference of two readings."""
NOISE_S = 1.0
SHARE_OF_EVP = 1.0 / 3.0
"""A loss above this share of the fully open inflation valve's flow is a fault."""
HOT = 1.06
"""Limit as a share of the full reservoir's pressure. The error band of a good sensor ends below it."""
HIGH_S = 1.0


class ReservoirLoss:
    """Finds an outflow from the reservoir that is larger than the commanded openings of the valves allow."""

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._blocks: deque[tuple[float, float]] = deque(maxlen=SPANS_BLOCKS[-1] + 1)
        """Mean reading of each block, and the maximum commanded outflow up to its middle."""
        self._outflow_SL = 0.0
        """Maximum commanded outflow since the start."""
        self._sum_kPa_s = self._block_s = 0.0
        self._block_began_SL = 0.0
        self._reading_kPa: float | None = None
        self._noise_kPa = 0.0
        self._finding: str | None = None

    def look(self, now: Features) -> str | None:
        self._outflow_SL += self._rig.max_outflow_SL(now)
        if self._reading_kPa is not None:
            difference_kPa = abs(now.telemetry.reservoir_kPa - self._reading_kPa)
            self._noise_kPa += (difference_kPa - self._noise_kPa) * min(1.0, now.device_dt_s / NOISE_S)
        self._reading_kPa = now.telemetry.reservoir_kPa
        self._sum_kPa_s += now.telemetry.reservoir_kPa * now.device_dt_s
        self._block_s += now.device_dt_s
        if self._block_s >= BLOCK_S - 1e-6:
            middle_SL = 0.5 * (self._block_began_SL + self._outflow_SL)
            self._blocks.append((self._sum_kPa_s / self._block_s, middle_SL))
            self._sum_kPa_s = self._block_s = 0.0
            self._block_began_SL = self._outflow_SL
            self._finding = self._judge()
        return self._finding

    def _judge(self) -> str | None:
        kPa, outflow_SL = self._blocks[-1]
        open_kPa_per_s = self._rig.reservoir_fall_kPa(self._rig.open_evp_SL_per_s(kPa))
        for blocks in SPANS_BLOCKS:
            if len(self._blocks) <= blocks:
                continue
            before_kPa, before_SL = self._blocks[-1 - blocks]
            seconds = blocks * BLOCK_S
            # A quick (adiabatic) fall is γ times the isothermal one.
            expected_kPa = GAMMA * self._rig.reservoir_fall_kPa(outflow_SL - before_SL)
            lost_kPa = before_kPa - kPa - expected_kPa
            if lost_kPa > MARGIN_KPA + self._noise_kPa + SHARE_OF_EVP * open_kPa_per_s * seconds:
                return f"reservoir loses {lost_kPa / seconds:.0f} kPa/s too much"
        return None


class Hot:
    """Finds a pressure above that of a full reservoir: the reservoir is hot or overfilled."""

    def __init__(self, rig: Expected) -> None:
        self._max_kPa = HOT * rig.full_kPa
        self._high_s = 0.0

    def look(self, now: Features) -> str | None:
        self._high_s = self._high_s + now.device_dt_s if now.telemetry.reservoir_kPa > self._max_kPa else 0.0
        if self._high_s < HIGH_S:
            return None
        return f"reservoir at {now.telemetry.reservoir_kPa:.0f} kPa: hot or overfilled"

"""The telemetry that the firmware would send during a simulated run of the plant."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.physics.plant.compiled import CompiledRun


def telemetry_of(run: CompiledRun) -> Iterator[tuple[float, Telemetry]]:
    """The time and the message of each row of a closed loop."""
    for row in run.table:
        setpoint = float(np.nan_to_num(row["setpoint_kPa"]))
        cv, reservoir = float(row["cv_reading_kPa"]), float(row["reservoir_reading_kPa"])
        evp, dvp, solenoid = float(row["evp"]), float(row["dvp"]), bool(row["solenoid"] > 0.5)
        yield (
            float(row["time_s"]),
            Telemetry(0, Mode.REGULATE, Fault.NONE, 0, setpoint, cv, reservoir, evp, dvp, solenoid),
        )

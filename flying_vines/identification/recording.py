"""A recorded run of a rig, and the error for a recording that cannot be used."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.files.toml_text import one_line
from flying_vines.physics.arrays import Array


class CaseError(ValueError):
    """A case cannot be read. Its text is one line: where, what is wrong, and what to do."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


def counted(count: int, name: str) -> str:
    """`1 row` or `2 rows`."""
    return f"{count} {name}{'' if count == 1 else 's'}"


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """One recorded run. All arrays have one element for each sample and are read-only; pressures are gauge.

    Time rises strictly. An input holds until the next sample. A pressure is NaN where there is no reading,
    and all NaN if it was not recorded; at least one pressure was recorded. EVP is the inflation valve, DVP
    the valve that supplies the Venturi.
    """

    name: str
    """File name without its ending."""
    time_s: Array
    command_kPa: Array | None
    """NaN while the regulator was off; None if it was not recorded."""
    evp_opening: Array
    dvp_opening: Array
    solenoid: Array
    """0 shut, 1 open."""
    cv_kPa: Array
    reservoir_kPa: Array
    ambient_kPa: Array | None
    """Absolute; linear between readings."""
    ambient_C: Array | None
    """Linear between readings."""
    to_atmosphere: bool
    """No control volume: the inflation valve discharges to atmosphere."""
    after_gap: Array | None = None
    """1 at a sample whose pressures do not follow from the previous sample, for example because a valve
    moved at an unknown time; otherwise 0. None if there is no such sample."""

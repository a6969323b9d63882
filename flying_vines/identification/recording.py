"""What was recorded of a rig, and the error that says why it cannot be used."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.config.toml_text import one_line
from flying_vines.physics.arrays import Array


class CaseError(ValueError):
    """A case that cannot be read; its text is one line that says what is wrong, where, and what to do."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """One recorded run, an element a sample; gauge pressures. The arrays are of one length and read-only.

    Time rises strictly. Inputs hold from their sample until the next. A pressure is NaN where there is no
    reading, all NaN where it was not recorded; at least one pressure was.
    """

    name: str
    """The file's, without its ending."""
    time_s: Array
    command_kPa: Array | None
    """NaN where nothing regulated, None where nothing is known to have."""
    evp_opening: Array
    dvp_opening: Array
    solenoid: Array
    """0 shut, 1 open."""
    cv_kPa: Array
    reservoir_kPa: Array
    ambient_kPa: Array | None
    """Absolute. Of the air around, what was not read is on a straight line between readings."""
    ambient_C: Array | None
    to_atmosphere: bool
    """No control volume: what passes the inflation valve is gone."""

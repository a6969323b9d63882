"""Writes a case folder: one CSV per run, and the rig file. Equal runs give equal bytes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from flying_vines.files.bounded import read_bytes
from flying_vines.simulation.scenario.run import OPENING_DIGITS, ScenarioRun

RIG = "rig.toml"
TRUE_RIG = "truth.toml"
"""Readers of cases ignore this file, because a diagnosis must not know the true rig."""
_COLUMNS: dict[str, Callable[[float], str]] = {
    "time_s": lambda x: f"{x:.3f}",
    "command_kPa": lambda x: "" if math.isnan(x) else _plain(x, 3),
    "evp_opening": lambda x: f"{round(x, OPENING_DIGITS):g}",
    "dvp_opening": lambda x: f"{round(x, OPENING_DIGITS):g}",
    "solenoid": lambda x: f"{x:.0f}",
    "cv_pressure_kPa": lambda x: _plain(x, 3),
    "reservoir_pressure_kPa": lambda x: _plain(x, 2),
}


class CaseFolderError(ValueError):
    """The folder must not be written to; the text is one sentence."""


def csv_text(run: ScenarioRun) -> str:
    """A run as CSV, without the pressure of a control volume or reservoir that the rig does not have."""
    names = [
        name for name in _COLUMNS if "pressure" not in name or not math.isnan(float(getattr(run, name)[0]))
    ]
    columns = [map(_COLUMNS[name], getattr(run, name).tolist()) for name in names]
    return "\n".join([",".join(names), *map(",".join, zip(*columns, strict=True)), ""])


def case_files(runs: Sequence[ScenarioRun]) -> tuple[str, ...]:
    """The file names of these runs."""
    return tuple(f"run_{number}_{run.label}.csv" for number, run in enumerate(runs, start=1))


def write_case(
    runs: Sequence[ScenarioRun], rig_toml: bytes, folder: Path, true_rig_toml: bytes | None = None
) -> list[Path]:
    """Create or renew a case folder. Returns the paths of its CSV files in the order of the runs.

    Existing files of these names are overwritten. Raises `CaseFolderError` if the folder has a CSV of another
    scenario, or another rig, because that would mix two cases.

    Args:
        runs: the recorded runs.
        rig_toml: the assumed rig.
        folder: the case folder.
        true_rig_toml: the true rig, if it differs from the assumed one; its file is `TRUE_RIG`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = case_files(runs)
    strangers = sorted(path.name for path in folder.glob("*.csv") if path.name not in names)
    if strangers:
        raise CaseFolderError(
            f"{folder}: contains {strangers[0]}, which is not a run of this scenario; give another folder"
        )
    rigs = {folder / RIG: rig_toml, folder / TRUE_RIG: true_rig_toml}
    for path, text in rigs.items():
        if path.exists() and read_bytes(path) != text:
            raise CaseFolderError(
                f"{path}: exists already and differs from the simulated rig; give another folder"
            )
    for path, text in rigs.items():
        if text is not None:
            path.write_bytes(text)
    paths = [folder / name for name in names]
    for path, run in zip(paths, runs, strict=True):
        path.write_bytes(csv_text(run).encode())
    return paths


def _plain(x: float, digits: int) -> str:
    text = f"{x:.{digits}f}"
    # No "-0.000".
    return text.removeprefix("-") if float(text) == 0.0 else text

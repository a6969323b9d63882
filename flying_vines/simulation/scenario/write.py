"""A case folder: a CSV a run, and the rig beside them. The same runs give the same bytes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from flying_vines.simulation.scenario.run import OPENING_DIGITS, ScenarioRun

RIG = "rig.toml"
TRUE_RIG = "truth.toml"
"""No reader of cases opens it: a diagnosis must not know the answer."""
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
    """A folder that is not to be written into; its text is one sentence for people."""


def csv_text(run: ScenarioRun) -> str:
    """A run as a file. Without a control volume there is no column of its pressure."""
    names = [name for name in _COLUMNS if name != "cv_pressure_kPa" or not math.isnan(run.cv_pressure_kPa[0])]
    columns = [map(_COLUMNS[name], getattr(run, name).tolist()) for name in names]
    return "\n".join([",".join(names), *map(",".join, zip(*columns, strict=True)), ""])


def case_files(runs: Sequence[ScenarioRun]) -> tuple[str, ...]:
    """What the files of these runs are called."""
    return tuple(f"run_{number}_{run.label}.csv" for number, run in enumerate(runs, start=1))


def write_case(
    runs: Sequence[ScenarioRun], rig_toml: bytes, folder: Path, true_rig_toml: bytes | None = None
) -> list[Path]:
    """Make or renew a case folder: where its CSV files are, in the order of the runs.

    Files of the same names are written over. CaseError when the folder has a CSV of another scenario, or
    another rig, for that would mix two cases.

    Args:
        runs: what was recorded.
        rig_toml: what the rig is believed to be.
        folder: of the case.
        true_rig_toml: what is really there, if that is more; written beside, under another name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = case_files(runs)
    strangers = sorted(path.name for path in folder.glob("*.csv") if path.name not in names)
    if strangers:
        raise CaseFolderError(
            f"{folder}: holds {strangers[0]}, which is no run of this scenario; give another folder"
        )
    rigs = {folder / RIG: rig_toml, folder / TRUE_RIG: true_rig_toml}
    for path, text in rigs.items():
        if path.exists() and path.read_bytes() != text:
            raise CaseFolderError(
                f"{path}: is there already and differs from the rig that is simulated; give another folder"
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
    # There is no pressure of minus zero.
    return text.removeprefix("-") if float(text) == 0.0 else text

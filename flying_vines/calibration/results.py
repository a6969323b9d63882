"""The results of a calibration on the terminal and as files, in the folder `calibration` of its flight.

findings.json        every quantity with its interval; the typed angles; the proposals for the firmware
calibrated.toml      the user's configuration with the measured values; profile-before.toml: without them
calibration.html     table and pictures in one page; each picture as SVG and PNG beside it
measured-rig.toml    the measured numbers as a rig file; rig.toml: also the causes that the diagnosis names
diagnosis/           the report of the diagnosis
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flying_vines.calibration.configuration import (
    ConfigurationChange,
    calibrated,
    changes,
    is_precise,
    with_numbers,
)
from flying_vines.calibration.findings import Findings
from flying_vines.calibration.rig import CalibrationRun, UserConfiguration
from flying_vines.calibration.terminal import CalibrationTerminal
from flying_vines.config import on_disk
from flying_vines.config.config import ConfigError, PneumaticsConfig
from flying_vines.files.extras import lacks
from flying_vines.physics.plant.true_rig import TrueRig, true_rig_text
from flying_vines.supply import nominal_rig
from flying_vines.supply.rig_file_prior import load_rig_file_prior

if TYPE_CHECKING:
    from flying_vines.identification.case import Case

FOLDER = "calibration"
DIAGNOSED_S = 20.0
"""Duration of the diagnosed part. With many effects, diagnosing some minutes of data takes an hour."""
MIN_TOLERANCE_PERCENT, MAX_TOLERANCE_PERCENT = 1.0, 10.0
RIG_KEYS = {
    "reservoir_volume_L": "reservoir.volume_L",
    "cv_volume_L": "cv.volume_L",
    "evp_flow_resistance_kPa_s_per_SL": "evp.flow_resistance_kPa_s_per_SL",
    "dvp_flow_resistance_kPa_s_per_SL": "dvp.flow_resistance_kPa_s_per_SL",
}
"""Keys of a rig file. The names on the left are those of the findings and of the keys in `[pneumatics]`."""
NUMBERS = tuple(f"pneumatics.{name}" for name in RIG_KEYS)
NOISE = {"cv_noise_kPa": "cv_noise_std_kPa", "reservoir_noise_kPa": "reservoir_noise_std_kPa"}


def write_results(
    run: CalibrationRun,
    user: UserConfiguration,
    terminal: CalibrationTerminal,
    diagnose: bool,
    in_place: bool,
) -> None:
    """Raises `OSError` if a file cannot be written.

    Args:
        in_place: also replace the user's configuration by the calibrated one.
    """
    folder, findings = run.folder / FOLDER, run.findings
    folder.mkdir()
    terminal.results(findings)
    if run.log_problem:
        terminal.warn(run.log_problem)
    content = {"outcome": run.ended.outcome, "sentence": run.ended.sentence, **findings.as_json()}
    _write(folder / "findings.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
    _write(folder / "profile-before.toml", user.text)
    changed = list(changes(findings, user.config.limits.max_kPa))
    for finding in findings.findings:
        if finding.key in NUMBERS and finding.value is not None and not is_precise(finding):
            terminal.warn(f"{finding.what}: not precise enough; the configuration keeps the old value")
    if changed and user.config.pneumatics.rig:
        changed = [*_instead_of_rig(user.config.pneumatics.rig, run.pneumatics, changed), *changed]
    numbers = with_numbers(user.config, changed).pneumatics
    rig_file = folder / "measured-rig.toml"
    _write(rig_file, rig_text(numbers, findings))
    places = [folder / "calibrated.toml"]
    if in_place and user.path is not None:
        places.append(user.path)
    if changed:
        _write_configurations(user, changed, None, places, terminal)
    if findings.charts:
        _draw(run, folder, terminal)
    extended = _diagnose(run.folder, rig_file, numbers, terminal) if diagnose else None
    if extended is not None:
        _write_configurations(user, changed, extended, places, terminal)
    if changed:
        for place in places:
            terminal.line("Configuration", place)
    terminal.line("Log", run.folder)


def rig_text(numbers: PneumaticsConfig, findings: Findings) -> str:
    """A rig file with the measured numbers (`numbers`), their intervals as tolerances, and the noise."""
    rig = nominal_rig(numbers)
    noise = {}
    for name, key in NOISE.items():
        found = findings.get(name)
        if found is not None and found.value is not None:
            noise[key] = float(f"{found.value:.3g}")
    tolerances = dict(_tolerances(findings))
    return true_rig_text(
        TrueRig(replace(rig, sensors=replace(rig.sensors, **noise), tolerance_percent=tolerances))
    )


def _tolerances(findings: Findings) -> Iterator[tuple[str, float]]:
    for name, key in RIG_KEYS.items():
        found = findings.get(name)
        if found and found.value and found.interval:
            value, low, high = found.interval
            percent = 50.0 * (high - low) / value
            yield key, round(min(max(percent, MIN_TOLERANCE_PERCENT), MAX_TOLERANCE_PERCENT), 1)


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _draw(run: CalibrationRun, folder: Path, terminal: CalibrationTerminal) -> None:
    try:
        from flying_vines.calibration.page import page, pictures
    except ModuleNotFoundError as error:
        terminal.warn(f"No pictures: {lacks(error)}")
        return
    drawn = pictures(run.findings.charts, folder)
    path = folder / "calibration.html"
    _write(path, page(f"Calibration {run.folder.name}", run.ended.sentence, run.findings, drawn))
    terminal.line("Page", path)


def _diagnose(
    flight: Path, rig_file: Path, numbers: PneumaticsConfig, terminal: CalibrationTerminal
) -> Path | None:
    """Diagnose the recording, from the rig file with the measured numbers; needs the extra `analysis`.

    Returns the rig file that the configuration should name, if there is one. It must improve the estimate of
    the cycles left: its causes lower the error on unseen data, and change the air that a cycle takes.
    """
    command = f"flying-vines diagnose --from-log {flight} --rig {rig_file}"
    try:
        from flying_vines.identification.diagnose import diagnose
        from flying_vines.identification.from_log import read_flight
        from flying_vines.identification.recording import CaseError
        from flying_vines.identification.report import write_report
        from flying_vines.identification.verdict import extended_rig
    except ModuleNotFoundError as error:
        terminal.warn(f"No diagnosis: {lacks(error)}. Then: {command}")
        return None
    try:
        with terminal.working() as progress:
            case = _beginning(read_flight(flight, rig_file))
            verdict = diagnose(case, progress=progress)
            report = write_report(verdict, case, rig_file.parent / "diagnosis")[0]
    except CaseError as error:
        terminal.warn(f"No diagnosis: {error}")
        return None
    except KeyboardInterrupt:
        terminal.warn(f"No diagnosis now; later: {command}")
        return None
    helps = False
    if verdict.named:
        rig = rig_file.parent / "rig.toml"
        _write(rig, true_rig_text(extended_rig(case.rig, verdict)))
        helps = verdict.held_out.gain[0] > 0.0 and bool(load_rig_file_prior(rig, numbers).used)
    terminal.diagnosis(verdict, report, helps)
    return rig if helps else None


def _beginning(case: Case) -> Case:
    """The first `DIAGNOSED_S` of the first run, with a remark."""
    run = case.runs[0]
    rows = int(np.searchsorted(run.time_s, DIAGNOSED_S))
    columns: dict[str, Any] = {
        field.name: value[:rows]
        for field in fields(run)
        if isinstance(value := getattr(run, field.name), np.ndarray)
    }
    remark = f"only the first {DIAGNOSED_S:g} s of movement are diagnosed"
    return replace(case, runs=(replace(run, **columns),), remarks=(*case.remarks, remark))


def _write_configurations(
    user: UserConfiguration,
    changed: list[ConfigurationChange],
    rig: Path | None,
    places: list[Path],
    terminal: CalibrationTerminal,
) -> None:
    for place in places:
        wanted = list(changed)
        if rig is not None:
            where = os.path.relpath(rig, place.parent)
            wanted.append(
                ConfigurationChange("pneumatics", "rig", where, "with the causes that the diagnosis names")
            )
        try:
            text, left_out = calibrated(user.text, user.name, wanted, time.strftime("%Y-%m-%d"))
        except ConfigError as error:
            terminal.warn(str(error))
            return
        if left_out and place is places[0]:
            terminal.warn(left_out)
        on_disk.put(place, text)


def _instead_of_rig(
    name: str, pneumatics: PneumaticsConfig, changed: list[ConfigurationChange]
) -> Iterator[ConfigurationChange]:
    """Clears `pneumatics.rig`, and copies the numbers of the rig file that were not measured."""
    yield ConfigurationChange("pneumatics", "rig", "", "a rig file would have priority over these numbers")
    measured = {change.name for change in changed}
    for key in RIG_KEYS:
        if key not in measured:
            yield ConfigurationChange("pneumatics", key, getattr(pneumatics, key), f"as in {name}")

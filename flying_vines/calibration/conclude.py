"""After a calibration: what was found, shown and put into files, in a folder of its own within its flight's.

findings.json        every quantity with its interval; what was typed; what is proposed for the firmware
calibrated.toml      the person's profile with what was measured in it; believed.toml as it was
calibration.html     table and pictures as one page; each picture as SVG and PNG beside it
believed-rig.toml    the measured numbers as a rig file; rig.toml with what the diagnosis found besides
diagnosis/           its report
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from flying_vines.calibration.conductor import Conducted
from flying_vines.calibration.procedure import Walk
from flying_vines.calibration.profile import ProfileChange, calibrated, changes, is_sure, with_numbers
from flying_vines.calibration.rig_file import KEYS, rig_text
from flying_vines.config import on_disk
from flying_vines.config.config import Config, ConfigError, PneumaticsConfig
from flying_vines.config.extras import lacks

FOLDER = "calibration"
NUMBERS = tuple(f"pneumatics.{name}" for name in KEYS)


@dataclass(frozen=True)
class UserProfile:
    """Of whoever calibrates."""

    text: str
    """Of the profile."""
    path: Path | None
    """Where it is; None: it is the built-in one."""
    config: Config
    """As it is written."""

    @property
    def name(self) -> str:
        return str(self.path or "the built-in profile")


def conclude(
    conducted: Conducted,
    profile: UserProfile,
    believed: PneumaticsConfig,
    walk: Walk,
    diagnose: bool,
    in_place: bool,
) -> None:
    """Write all files and show what is in them; `OSError` where they cannot be written.

    Args:
        believed: what was, of the rig file where the profile names one.
        in_place: put the calibrated profile in the place of the person's, too.
    """
    folder = conducted.folder / FOLDER
    folder.mkdir()
    findings = conducted.findings
    walk.found(findings)
    if conducted.log_problem:
        walk.warn(conducted.log_problem)
    ended = conducted.ended
    told = {"outcome": ended.outcome, "sentence": ended.sentence, **findings.as_json()}
    _write(folder / "findings.json", json.dumps(told, indent=1, allow_nan=False) + "\n")
    _write(folder / "believed.toml", profile.text)
    changed = list(changes(findings, profile.config.limits.max_kPa))
    for finding in findings.findings:
        if finding.key in NUMBERS and finding.value is not None and not is_sure(finding):
            walk.warn(f"{finding.what}: not sure enough for the profile, which keeps its own")
    if changed and profile.config.pneumatics.rig:
        changed = [*_of_the_rig_file(profile.config.pneumatics.rig, believed, changed), *changed]
    numbers = with_numbers(profile.config, changed).pneumatics
    rig_file = folder / "believed-rig.toml"
    _write(rig_file, rig_text(numbers, findings))
    places = [folder / "calibrated.toml"]
    if in_place and profile.path is not None:
        places.append(profile.path)
    if changed:
        _write_profiles(profile, changed, None, places, walk)
    if conducted.charts:
        _draw(conducted, folder, walk)
    extended = _diagnose(conducted, rig_file, numbers, walk) if diagnose else None
    if extended is not None:
        _write_profiles(profile, changed, extended, places, walk)
    if changed:
        for place in places:
            walk.at_last("Profile", place)
    walk.at_last("Log", conducted.folder)


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _draw(conducted: Conducted, folder: Path, walk: Walk) -> None:
    try:
        from flying_vines.calibration.page import page
        from flying_vines.calibration.pictures import pictures
    except ModuleNotFoundError as error:
        walk.warn(f"No pictures: {lacks(error)}")
        return
    drawn = pictures(conducted.charts, folder)
    path = folder / "calibration.html"
    _write(path, page(f"Calibration {conducted.folder.name}", conducted, drawn))
    walk.at_last("Page", path)


def _diagnose(conducted: Conducted, believed: Path, numbers: PneumaticsConfig, walk: Walk) -> Path | None:
    """The rig file that the profile should name, if any."""
    command = f"flying-vines diagnose --from-log {conducted.folder} --rig {believed}"
    try:
        from flying_vines.calibration.diagnosis import diagnosed
        from flying_vines.identification.recording import CaseError
    except ModuleNotFoundError as error:
        walk.warn(f"No diagnosis: {lacks(error)}. Then: {command}")
        return None
    try:
        with walk.working() as progress:
            diagnosis = diagnosed(conducted.folder, believed, numbers, progress)
    except CaseError as error:
        walk.warn(f"No diagnosis: {error}")
        return None
    except KeyboardInterrupt:
        walk.warn(f"No diagnosis now; later: {command}")
        return None
    walk.diagnosis(diagnosis)
    return diagnosis.rig if diagnosis.helps else None


def _write_profiles(
    profile: UserProfile, changed: list[ProfileChange], rig: Path | None, places: list[Path], walk: Walk
) -> None:
    """The calibrated profile, in each of the places."""
    for place in places:
        wanted = list(changed)
        if rig is not None:
            where = os.path.relpath(rig, place.parent)
            wanted.append(
                ProfileChange("pneumatics", "rig", where, "with the causes that the diagnosis names")
            )
        try:
            text, left_out = calibrated(profile.text, profile.name, wanted, time.strftime("%Y-%m-%d"))
        except ConfigError as error:
            walk.warn(str(error))
            return
        if left_out and place is places[0]:
            walk.warn(left_out)
        on_disk.put(place, text)


def _of_the_rig_file(
    name: str, believed: PneumaticsConfig, changed: list[ProfileChange]
) -> Iterator[ProfileChange]:
    """A rig file would go before the measured numbers: it is named no more, and what else it says is kept."""
    yield ProfileChange("pneumatics", "rig", "", "it would go before these numbers")
    measured = {change.name for change in changed}
    for key in KEYS:
        if key not in measured:
            yield ProfileChange("pneumatics", key, getattr(believed, key), f"as in {name}")

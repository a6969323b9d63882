"""The file of the parameters that were set in the field.

It holds only values that differ from the configuration. All others follow the configuration. A file that
cannot be read is never overwritten, so its content is not lost.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flying_vines.config import on_disk
from flying_vines.config.config import OLD_SETTINGS, Config, ignored
from flying_vines.files.toml_text import Key, OneLineError, parsed, place, read_text
from flying_vines.vehicle.component.parameter_table import (
    BY_NAME,
    SETTINGS,
    ParameterRefused,
    changed,
    value_of,
)

END = "# end"
MARK = f'# Without "{END}" as its last line this file is cut off.\n'
HEADING = f"""\
{MARK}# Vine parameters set from a ground station. They override the configuration.
# To use the configuration's value again, delete the line and restart the service.
"""

OLD_PARAMETERS: dict[Key, str] = {
    ("VINE_AP_ACTION",): OLD_SETTINGS["losses", "on_autopilot_loss"],
    ("VINE_FUEL_STATUS",): OLD_SETTINGS["telemetry", "fuel_status"],
}
"""Parameters of earlier versions, which are ignored, and why."""


_REMEDY = "set them again after deleting the file"


class ParameterFileError(OneLineError):
    """The file cannot be used. The text is one line with file, line number and what to do."""


def read(path: Path, base: Config) -> dict[str, float]:
    """The values of a file, all allowed by the configuration `base`. Empty if there is no file yet.

    Raises:
        ParameterFileError: the file is damaged, or has a value that `base` does not allow.
    """
    if not path.exists():
        return {}
    text = read_text(path, ParameterFileError)
    # A file of an earlier version, or of a person, has no end. Without this check, limits from the field
    # would end unseen.
    has_end = MARK.startswith(text.strip()) or text.startswith(MARK)
    if has_end and text.rstrip().rpartition("\n")[2] != END:
        raise ParameterFileError(f"{path}: is empty or cut off: parameters are lost; {_REMEDY}")
    values = _parsed(text, path)
    config = base
    for name, value in values.items():
        try:
            config = changed(base, config, name, value)
        except ParameterRefused as refusal:
            where = place(text, str(path), (name,))
            raise ParameterFileError(f"{where}: {refusal}: correct the line or delete it") from None
    return values


def write(path: Path, values: Mapping[str, float], base: Config) -> None:
    """Replace the file by these values, atomically.

    Raises:
        ParameterFileError: the present file is not a parameter file, or it cannot be written.
    """
    try:
        if path.exists():
            _parsed(read_text(path, ParameterFileError), path)
        on_disk.put(path, _text(values, base))
    except OSError as error:
        raise ParameterFileError(f"{path}: cannot be written: {error.strerror}") from None


def _text(values: Mapping[str, float], base: Config) -> str:
    rows = [HEADING]
    for setting in SETTINGS:
        if setting.name in values:
            rows.append(f"\n# {setting.doc} (configuration: {value_of(setting, base):g})\n")
            rows.append(f"{setting.name} = {values[setting.name]!r}\n")
    return "".join([*rows, f"\n{END}\n"])


def _parsed(text: str, path: Path) -> dict[str, float]:
    """The numbers of known parameters, by name."""
    try:
        raw = parsed(text, str(path), ParameterFileError)
    except ParameterFileError as error:
        raise ParameterFileError(f"{error}; correct the line, or {_REMEDY}") from None
    return {
        name: _number(name, value, place(text, str(path), (name,)))
        for name, value in raw.items()
        if (name,) not in OLD_PARAMETERS
    }


def ignored_in(path: Path) -> list[str]:
    """A line for each parameter of an earlier version in the file."""
    return ignored(read_text(path, ParameterFileError), str(path), OLD_PARAMETERS) if path.exists() else []


def _number(name: str, value: Any, where: str) -> float:
    if name not in BY_NAME:
        near = difflib.get_close_matches(name, BY_NAME, n=1)
        hint = f"; did you mean {near[0]}?" if near else ": delete the line"
        raise ParameterFileError(f"{where}: {name}: there is no such parameter{hint}")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ParameterFileError(f"{where}: {name}: it must be a number")
    return float(value)

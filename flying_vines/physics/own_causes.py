"""Causes from outside this project: a Python file, or an installed package.

A file defines one or more `Cause`s, exactly as a file in `effects` does. A package names its causes as entry
points of the group `flying_vines.causes`.
"""

from __future__ import annotations

import sys
import traceback
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType

from flying_vines.files.bounded import read_bytes
from flying_vines.physics.cause import Cause, CauseError
from flying_vines.physics.plant.plant import perfect
from flying_vines.physics.rig import Pump, Rig

ENTRY_POINTS = "flying_vines.causes"


def read_causes(path: Path | str) -> tuple[Cause, ...]:
    """The causes that a Python file defines. The file is run.

    Raises CauseError if the file cannot be read or has an error.
    """
    path = Path(path)
    module = ModuleType(f"cause_file_{path.stem}")
    module.__file__ = str(path)
    # A dataclass looks up its module in sys.modules.
    sys.modules[module.__name__] = module
    try:
        exec(compile(read_bytes(path), str(path), "exec"), vars(module))
    except OSError as error:
        raise CauseError(f"{path}: {error.strerror}") from None
    except SyntaxError as error:
        raise CauseError(f"{path}:{error.lineno}: {error.msg}") from None
    except (Exception, SystemExit) as error:
        raise CauseError(_located(error, str(path))) from None
    found = {value.name: value for value in vars(module).values() if isinstance(value, Cause)}
    if not found:
        raise CauseError(f"{path}: defines no cause: write CAUSE = Cause(...)")
    return tuple(_checked(replace(cause, defined_in=path.name), str(path)) for cause in found.values())


def installed_causes() -> tuple[Cause, ...]:
    """The causes of installed packages. Raises CauseError if one cannot be loaded."""
    return tuple(map(_loaded, entry_points(group=ENTRY_POINTS)))


def _loaded(point: EntryPoint) -> Cause:
    package = f"package {point.dist.name}" if point.dist else point.module
    try:
        cause = point.load()
    except Exception as error:
        raise CauseError(f"{package}: cause {point.name}: {type(error).__name__}: {error}") from None
    if not isinstance(cause, Cause):
        raise CauseError(f"{package}: {point.value} is not a Cause")
    return _checked(replace(cause, defined_in=package), package)


def _checked(cause: Cause, where: str) -> Cause:
    """Returns the cause after applying it once to a default rig, so that its errors appear now."""
    if cause.apply is None:
        raise CauseError(f"{where}: cause {cause.name} needs apply=: a function that changes a rig")
    values = dict(zip([p.name for p in cause.parameters], cause.seeds()[0], strict=True))
    cause.put_into(perfect(replace(Rig(), pump=Pump()) if "pump" in cause.needs else Rig()), values)
    return cause


def _located(error: BaseException, path: str) -> str:
    """The error's text, with the last line of this file in the traceback."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == path]
    where = f"{path}:{lines[-1]}" if lines else path
    return f"{where}: {type(error).__name__}: {error}"

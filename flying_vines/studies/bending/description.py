"""A vine in a TOML file: its body, and the actuator that bends it."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, get_args

import msgspec
from msgspec import Meta

from flying_vines.files.toml_text import OneLineError, explained, located, not_finite, parsed, read_text
from flying_vines.physics.constants import STANDARD_PRESSURE_KPA
from flying_vines.studies.bending.body import Body
from flying_vines.studies.bending.cpam import Cpam
from flying_vines.studies.bending.fpam import Fpam
from flying_vines.studies.bending.pouch_motor import PouchMotor

ActuatorKind = PouchMotor | Fpam | Cpam
_KINDS = {str(kind.__struct_config__.tag): kind for kind in get_args(ActuatorKind)}
_EXAMPLES = resources.files("flying_vines.studies.bending") / "examples"


class VineError(OneLineError, ValueError):
    """A description cannot be used; the text is one line, `file:line: key: reason`."""


class BendingVine(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An inflated tube with one actuator along its side; both have the same length."""

    name: Annotated[str, Meta(min_length=1, max_length=60)]
    max_kPa: Annotated[float, Meta(ge=0.1, le=1000)]
    """Maximum supply pressure of the actuator, gauge."""
    tip_load_N: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    """Load that the tip must bear, across the vine."""
    ambient_kPa: Annotated[float, Meta(ge=20, le=120)] = STANDARD_PRESSURE_KPA
    """Absolute."""
    body: Body
    actuator: ActuatorKind


def examples() -> tuple[str, ...]:
    """The names of the built-in vines, the paper's first."""
    names = (entry.name for entry in _EXAMPLES.iterdir())
    found = sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))
    return tuple(sorted(found, key=lambda name: name != "pouch"))


def example_text(name: str) -> str:
    """The commented file of an example."""
    return (_EXAMPLES / f"{name}.toml").read_text(encoding="utf-8")


def load_vine(source: Path | str) -> BendingVine:
    """The vine in a TOML file, or the example of this name if there is no such file.

    Raises `VineError` if the file cannot be read, or is not a valid vine.
    """
    path = Path(source)
    if not path.exists() and str(source) in examples():
        return parse_vine(example_text(str(source)), str(source))
    absent = f" and no such example; the examples are {', '.join(examples())}"
    return parse_vine(read_text(path, VineError, absent), str(path))


def parse_vine(text: str, source: str) -> BendingVine:
    """The vine in the text of a description; `source` is its name in errors."""
    content = parsed(text, source, VineError)
    for key in not_finite(content):
        raise VineError(located(text, source, key, "is not a finite number"))
    try:
        return msgspec.convert(content, BendingVine)
    except msgspec.ValidationError as error:
        raise _explained(text, source, content, str(error)) from None


def _explained(text: str, source: str, raw: object, error: str) -> VineError:
    parts = (BendingVine, Body, *_KINDS.values())
    fields = [field for part in parts for field in part.__struct_fields__]
    key, reason = explained(error, lambda key: fields, raw=raw)
    if reason.startswith("Invalid value") and key[-1:] == ("kind",):
        reason = f"give one of {', '.join(_KINDS)}"
    return VineError(located(text, source, key, reason))

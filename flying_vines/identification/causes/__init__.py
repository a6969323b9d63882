"""The catalogue: one file a cause, each with one `CAUSE`."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from flying_vines.identification.cause import Cause


@cache
def catalogue() -> tuple[Cause, ...]:
    """Every cause in this folder, by name."""
    modules = sorted(module.name for module in iter_modules(__path__))
    return tuple(import_module(f"{__name__}.{name}").CAUSE for name in modules)

"""The effects that a rig may have and a diagnosis may name.

A file has one effect on a plant and its sensors: its law, the parameters with bounds and sources, and the
experiment that shows the effect. The simulation, the fit and the rig file use these files. Names and
definitions are those of the rig-data format.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from flying_vines.physics.cause import Cause, CauseError, installed_causes
from flying_vines.physics.plant.plant import Setup, perfect
from flying_vines.physics.rig import Rig

_added: list[Cause] = []


@cache
def catalogue() -> tuple[Cause, ...]:
    """Every cause of this folder, by name; then those of installed packages, and those that were added."""
    modules = (import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__))
    own = (value for module in modules for value in vars(module).values() if isinstance(value, Cause))
    every: dict[str, Cause] = {}
    for cause in (*sorted(own, key=lambda cause: cause.name), *installed_causes(), *_added):
        if cause.name in every or cause.name in (NONE.name, "unexplained"):
            raise CauseError(f"{cause.defined_in}: the name {cause.name} is taken; choose another")
        every[cause.name] = cause
    return tuple(every.values())


def add_causes(causes: Iterable[Cause]) -> None:
    """Add causes to the catalogue of this process. Raises CauseError if a name is taken.

    A cause replaces an earlier added cause of the same name from the same file or package.
    """
    before, new = list(_added), list(causes)
    again = {(cause.name, cause.defined_in) for cause in new}
    _added[:] = [cause for cause in before if (cause.name, cause.defined_in) not in again] + new
    catalogue.cache_clear()
    try:
        catalogue()
    except CauseError:
        _added[:] = before
        raise


def causes_of(rig: Rig) -> tuple[Cause, ...]:
    """The causes that this rig can have: it has all parts that they need."""
    return tuple(cause for cause in catalogue() if all(map(rig.has, cause.needs)))


NONE = Cause(name="none", what="The rig agrees with the baseline.", parameters=(), experiment="")


def cause_named(name: str) -> Cause:
    """A cause, or `none`; KeyError for another name."""
    return {cause.name: cause for cause in (NONE, *catalogue())}[name]


def setup(rig: Rig, cause: str = "none", **parameters: float) -> Setup:
    """The rig with one cause; its sensors have the rig's noise. KeyError for an unknown name."""
    return cause_named(cause).put_into(perfect(rig), parameters)

"""Makes a method of any object in the core raise an error at a given time."""

from __future__ import annotations

import functools
import inspect
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from typing import Any

import msgspec

from firmware_link import protocol
from flying_vines.core.core import Core

OURS = ("flying_vines", "firmware_link")
ONLY_SHOWN = {"cycles_left", "_named_values", "snapshot"}
"""Methods whose errors do not vent the vine. The methods that they call may also be used elsewhere."""
Method = tuple[type, str]


class BrokenError(Exception):
    """An error that no code expects."""


def methods_within(core: Core) -> list[Method]:
    """Methods and properties of every class of which the core has an object now."""
    found: dict[type, None] = {}
    seen: set[int] = set()
    waiting: deque[object] = deque([core])
    while waiting:
        thing = waiting.popleft()
        if id(thing) in seen:
            continue
        seen.add(id(thing))
        if isinstance(thing, Mapping):
            waiting.extend(thing.values())
        elif isinstance(thing, (list, tuple, set, frozenset, deque)):
            waiting.extend(thing)
        if not type(thing).__module__.startswith(OURS) or isinstance(thing, (Enum, msgspec.Struct)):
            continue
        if type(thing).__module__ == protocol.__name__:
            continue  # the fake board also uses these classes
        found.update(dict.fromkeys(cls for cls in type(thing).__mro__ if cls.__module__.startswith(OURS)))
        names = [*getattr(thing, "__dict__", {}), *_slots(thing)]
        waiting.extend(getattr(thing, name) for name in names if hasattr(thing, name))
    return [
        (cls, name)
        for cls in found
        for name, member in vars(cls).items()
        if not name.startswith("__")
        and isinstance(member, property | staticmethod) | inspect.isfunction(member)
        if (cls, name) != (Core, "decided")
    ]


def _slots(thing: object) -> Iterator[str]:
    for cls in type(thing).__mro__:
        slots = vars(cls).get("__slots__", ())
        yield from (slots,) if isinstance(slots, str) else slots


@contextmanager
def breakable(
    method: Method, raises: Callable[[], bool], raised: Callable[[bool], None] = lambda needed: None
) -> Iterator[None]:
    """Make a method raise whenever `raises` returns true.

    Before the error, `raised` is called: with false if a method of `ONLY_SHOWN` is on the call stack, else
    with true.
    """
    cls, name = method
    before: Any = vars(cls)[name]

    def guarded(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def called(*arguments: Any, **named: Any) -> Any:
            if raises():
                callers = {frame.name for frame in traceback.extract_stack(limit=25)}
                raised(ONLY_SHOWN.isdisjoint(callers | {name}))
                raise BrokenError(f"{cls.__name__}.{name}")
            return function(*arguments, **named)

        return called

    after: Any
    if isinstance(before, property):
        after = property(guarded(before.fget)) if before.fget else before
    elif isinstance(before, staticmethod):
        after = staticmethod(guarded(before.__func__))
    else:
        after = guarded(before)
    setattr(cls, name, after)
    try:
        yield
    finally:
        setattr(cls, name, before)

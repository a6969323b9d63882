"""Flights with which many tests begin: each is simulated once, and every test gets its own copy."""

from __future__ import annotations

import ctypes
import io
import pickle
import struct
from collections.abc import Callable
from types import FunctionType
from typing import Any

from flying_vines.simulation.phlosar.firmware import Firmware
from flying_vines.simulation.simulated_world import SimulatedFlight

_shared: list[Any] = []
"""Objects that do not change and are shared by all copies."""
_stored: dict[tuple[Callable[..., SimulatedFlight], str], bytes] = {}


def prepared(begin: Callable[..., SimulatedFlight], *arguments: Any) -> SimulatedFlight:
    """A copy of the result of `begin(*arguments)`."""
    key = (begin, repr(arguments))  # a configuration has no hash
    if key not in _stored:
        file = io.BytesIO()
        _Pickler(file, pickle.HIGHEST_PROTOCOL).dump(begin(*arguments))
        _stored[key] = file.getvalue()
    flight: SimulatedFlight = _Unpickler(io.BytesIO(_stored[key])).load()
    return flight


class _Pickler(pickle.Pickler):
    """Copies within this process. Unlike `copy.deepcopy` it refuses objects that would act on the first
    flight."""

    def persistent_id(self, found: Any) -> int | None:
        if isinstance(found, struct.Struct | ctypes.CDLL) or _without_state(found):
            _shared.append(found)
            return len(_shared) - 1
        return None

    def reducer_override(self, found: Any) -> Any:
        match found:
            case Firmware():
                fields = {name: value for name, value in vars(found).items() if name != "_firmware"}
                return _board, (fields,)
            case ctypes.Array():
                return ctypes.create_string_buffer, (found.raw, len(found))
            case ctypes.Structure():
                return type(found), ()
        return NotImplemented


def _without_state(found: Any) -> bool:
    """True for a function with only numbers in its closure, such as a piece of a motion."""
    return isinstance(found, FunctionType) and all(
        isinstance(cell.cell_contents, float) for cell in found.__closure__ or ()
    )


class _Unpickler(pickle.Unpickler):
    def persistent_load(self, number: int) -> Any:
        return _shared[number]


def _board(fields: dict[str, Any]) -> Firmware:
    """The firmware's core has no pointer into its own memory, so it also runs in a copy of this memory."""
    board = Firmware.__new__(Firmware)
    vars(board).update(fields, _firmware=ctypes.addressof(fields["_memory"]))
    return board

"""Compiles plain functions over numbers with numba: the same source, about 90 times as fast.

A function is compiled with everything that it calls. Each function is rebuilt with globals in which the other
functions are compiled, so the sources need no decorator and run without numba. The machine code is cached on
disk. The cache key covers all functions, because numba's own cache only sees changes in the file of the
entry function.
"""

from __future__ import annotations

import ctypes
import dis
import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from operator import attrgetter
from pathlib import Path
from threading import Lock
from types import FunctionType
from typing import Any, TypeVar, cast, get_type_hints

import numpy as np

from flying_vines.files.extras import lacks

F = TypeVar("F", bound=Callable[..., Any])
_OURS = __name__.partition(".")[0]
_CONFIG_LOCK = Lock()
_TYPES = {float: "f8", int: "i8", bool: "?"}
Floats = tuple[float, ...]


class NoCompiler(ImportError):
    """numba is missing; the text is one sentence for people."""


@cache
def compiled(function: F, not_inlined: tuple[Callable[..., Any], ...] = ()) -> F:
    """The function, compiled at its first call (some seconds; less than a second from the cache).

    The arguments may be numbers, tuples of numbers, arrays and `record`s. All functions that the function
    calls are inlined, except those in `not_inlined`: large functions that are called from several places.
    Raises NoCompiler without numba.
    """
    try:
        import numba
    except ImportError as error:
        raise NoCompiler(f"compiling: {lacks(error)}") from None
    folder = _cache_folder(function)
    config: Any = numba.config
    with _CONFIG_LOCK:
        before = config.CACHE_DIR
        try:
            # numba reads this setting only during `njit`.
            config.CACHE_DIR = str(folder or before)
            entry = numba.njit(
                _rebuilt(function, not_inlined), error_model="numpy", nogil=True, cache=folder is not None
            )
        finally:
            config.CACHE_DIR = before
    return cast(F, entry)


def external(function: Any, signature: str) -> Any:
    """A library function that compiled functions can call, with numba's `signature`; None without numba."""
    try:
        from llvmlite.binding import add_symbol
        from numba.core import sigutils
        from numba.core.types import ExternalFunction
    except ImportError:
        return None
    name = function.__name__
    add_symbol(name, ctypes.cast(function, ctypes.c_void_p).value)
    normalize: Any = sigutils.normalize_signature
    arguments, result = normalize(signature)
    return ExternalFunction(name, result(*arguments))


def record(numbers: Any) -> np.void:
    """A tuple or dataclass of numbers, possibly nested, as a record for compiled functions."""
    kind: Any = type(numbers)
    layout, flat, values_of = _layout_and_reader(kind)
    return cast(np.void, np.array([values_of(numbers)], flat).view(layout)[0])


@cache
def _layout_and_reader(kind: Any) -> tuple[np.dtype[np.void], np.dtype[np.void], Callable[[Any], Any]]:
    """The record type, its form without nesting, and a function that reads all numbers in this order."""
    layout = _layout(kind)
    leaves = list(_leaves(layout))
    names, formats, offsets = zip(*leaves, strict=True)
    flat = np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": layout.itemsize}, align=True
    )
    return layout, flat, attrgetter(*names)


def _leaves(layout: np.dtype[np.void], path: str = "", at: int = 0) -> Iterator[tuple[str, Any, int]]:
    """Path, type and offset of each number of a record type."""
    for name, (part, offset, *_) in (layout.fields or {}).items():
        if part.fields is None:
            yield path + name, part, at + offset
        else:
            yield from _leaves(part, f"{path}{name}.", at + offset)


@cache
def _layout(kind: Any) -> np.dtype[np.void]:
    """The record type, from the declared types, so that it does not depend on the values.

    The length of a `Floats` field is that of its default.
    """
    hints = get_type_hints(kind)
    lengths = {name: len(kind._field_defaults[name]) for name in hints if hints[name] == Floats}
    parts = [
        (name, "f8", lengths[name]) if name in lengths else (name, _TYPES.get(hint) or _layout(hint))
        for name, hint in hints.items()
    ]
    return np.dtype(parts, align=True)


def _rebuilt(function: Callable[..., Any], not_inlined: tuple[Callable[..., Any], ...]) -> FunctionType:
    """The function with its callees replaced by compiled ones."""
    parts = {name: _part(called, not_inlined) for name, called in _called(function).items()}
    return FunctionType(
        function.__code__, {**function.__globals__, **parts}, function.__name__, function.__defaults__
    )


@cache
def _part(function: FunctionType, not_inlined: tuple[Callable[..., Any], ...]) -> Any:
    import numba

    return numba.njit(
        _rebuilt(function, not_inlined), error_model="numpy", forceinline=function not in not_inlined
    )


def _called(function: Callable[..., Any]) -> dict[str, FunctionType]:
    """The functions of this project that a function calls, by the names that it uses for them."""
    return {
        name: value
        for name, value in _globals(function).items()
        if isinstance(value, FunctionType) and value.__module__.startswith(_OURS)
    }


def _globals(function: Callable[..., Any]) -> dict[str, Any]:
    """The globals that a function uses, without built-ins."""
    names = sorted({i.argval for i in dis.get_instructions(function) if i.opname == "LOAD_GLOBAL"})
    return {name: function.__globals__[name] for name in names if name in function.__globals__}


def _content(function: Callable[..., Any]) -> Iterator[object]:
    """Everything that determines the machine code of a function and its callees."""
    code = function.__code__
    constants = tuple(constant for constant in code.co_consts if constant != function.__doc__)
    # The module's name counts too: the cached code imports modules by name.
    yield function.__module__, code.co_code, constants, code.co_names, code.co_varnames
    for name, value in _globals(function).items():
        if not callable(value) or hasattr(value, "_fields"):
            yield name, getattr(value, "_fields", value)
    for called in _called(function).values():
        yield from _content(called)


def _cache_folder(function: Callable[..., Any]) -> Path | None:
    """Cache folder of a function, named by the hash of its `_content`; None if it cannot be written."""
    digest = hashlib.sha256(repr(list(_content(function))).encode())
    try:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = root / "flying-vines" / f"compiled-{digest.hexdigest()[:16]}"
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError):  # RuntimeError: the user has no home directory
        return None

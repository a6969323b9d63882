"""Plain functions over numbers, compiled: the same source, about ninety times as fast.

Numba compiles the functions as they stand, with everything that they call: each is rebuilt with globals in
which the names of other functions are the compiled ones, so that no source knows of it. What was compiled is
kept on disk, under a name that changes with any of the sources.
"""

from __future__ import annotations

import ctypes
import dataclasses
import dis
import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from threading import Lock
from types import FunctionType
from typing import Any, TypeVar, cast, get_type_hints

import numpy as np

F = TypeVar("F", bound=Callable[..., Any])
_OURS = __name__.partition(".")[0]
_CONFIG_LOCK = Lock()
_TYPES = {float: "f8", int: "i8", bool: "?"}


class NoCompiler(ImportError):
    """Its text is one sentence for people."""


@cache
def compiled(function: F, apart: tuple[Callable[..., Any], ...] = ()) -> F:
    """The function, compiled when it is first called (some seconds, or a fraction of one from disk).

    It takes numbers, tuples of numbers, arrays, and `record`s. What it calls becomes a part of it, but for
    large functions that are called from several places: those are named `apart`. NoCompiler without numba.
    """
    try:
        import numba
    except ImportError:
        raise NoCompiler("compiling needs numba: pip install 'flying-vines[analysis]'") from None
    folder = _cache_folder(function)
    config: Any = numba.config
    with _CONFIG_LOCK:
        before = config.CACHE_DIR
        try:
            # Asked for only here, when the function is made.
            config.CACHE_DIR = str(folder or before)
            entry = numba.njit(
                _rebuilt(function, apart), error_model="numpy", nogil=True, cache=folder is not None
            )
        finally:
            config.CACHE_DIR = before
    return cast(F, entry)


def external(function: Any, signature: str) -> Any:
    """A library's function for compiled ones to call, by numba's `signature`; None without numba."""
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
    """A tuple or dataclass of numbers, in which others may be, as a compiled function takes it: by its
    names."""
    kind: Any = type(numbers)
    return cast(np.void, np.array([_values(numbers)], _layout(kind))[0])


@cache
def _layout(kind: type) -> np.dtype[np.void]:
    """Of the types that the names are declared to have, so that it never changes."""
    hints = get_type_hints(kind)
    return np.dtype([(name, _TYPES.get(hint) or _layout(hint)) for name, hint in hints.items()], align=True)


def _values(numbers: Any) -> Any:
    if isinstance(numbers, float):
        return numbers
    if dataclasses.is_dataclass(numbers):
        kind: Any = type(numbers)
        return tuple([_values(getattr(numbers, name)) for name in _layout(kind).names or ()])
    return tuple(map(_values, numbers)) if isinstance(numbers, tuple) else numbers


def _rebuilt(function: Callable[..., Any], apart: tuple[Callable[..., Any], ...]) -> FunctionType:
    """The function, calling compiled ones."""
    parts = {name: _part(called, apart) for name, called in _called(function).items()}
    return FunctionType(
        function.__code__, {**function.__globals__, **parts}, function.__name__, function.__defaults__
    )


@cache
def _part(function: FunctionType, apart: tuple[Callable[..., Any], ...]) -> Any:
    import numba

    return numba.njit(_rebuilt(function, apart), error_model="numpy", forceinline=function not in apart)


def _called(function: Callable[..., Any]) -> dict[str, FunctionType]:
    """Our own functions that this one calls, by the names by which it knows them."""
    return {
        name: value
        for name, value in _globals(function).items()
        if isinstance(value, FunctionType) and value.__module__.startswith(_OURS)
    }


def _globals(function: Callable[..., Any]) -> dict[str, Any]:
    """What a function looks up by name, but for what is built in."""
    names = sorted({i.argval for i in dis.get_instructions(function) if i.opname == "LOAD_GLOBAL"})
    return {name: function.__globals__[name] for name in names if name in function.__globals__}


def _content(function: Callable[..., Any]) -> Iterator[object]:
    """All that a function and those that it calls become machine code of."""
    code = function.__code__
    yield code.co_code, code.co_consts, code.co_names, code.co_varnames
    for name, value in _globals(function).items():
        if not callable(value) or hasattr(value, "_fields"):
            yield name, getattr(value, "_fields", value)
    for called in _called(function).values():
        yield from _content(called)


def _cache_folder(function: Callable[..., Any]) -> Path | None:
    """Where to keep what this becomes: another place for other sources; None when there is none."""
    digest = hashlib.sha256(repr(list(_content(function))).encode())
    try:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = root / "flying-vines" / f"compiled-{digest.hexdigest()[:16]}"
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError):  # the latter where nobody is at home
        return None

"""TOML texts and where their keys stand, so that an error is one line that names the line and the key."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

Key = tuple[str | int, ...]
"""The way to a value: table and key names, and indexes of arrays."""


def one_line(text: str) -> str:
    """Errors quote keys and values, which may hold anything: what it is shown as stays one line."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def key_of(path: str) -> Key:
    """The key that msgspec writes as `$.a.b[1]`."""
    parts = re.findall(r"\.[^.\[\]]+|\[\d+\]", path.strip("`").removeprefix("key in "))
    return tuple(int(part[1:-1]) if part.startswith("[") else part.strip(".") for part in parts)


def dotted(key: Key) -> str:
    """A key as people write it: `a.b[1].c`."""
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def not_finite(value: object, at: Key = ()) -> Iterator[Key]:
    """Where in tables and arrays a number is nan or infinite."""
    inner: Any = ()
    if isinstance(value, dict):
        inner = value.items()
    elif isinstance(value, list | tuple):
        inner = enumerate(value)
    elif isinstance(value, float) and not math.isfinite(value):
        yield at
    for key, part in inner:
        yield from not_finite(part, (*at, key))


def place(text: str, source: str, key: Key) -> str:
    """`source:line` of a key, or of the nearest table around it."""
    lines = _lines_of_keys(text)
    for length in range(len(key), 0, -1):
        if key[:length] in lines:
            return f"{source}:{lines[key[:length]]}"
    return source


def _lines_of_keys(text: str) -> dict[Key, int]:
    """Where each table and each key stands; tomllib does not say."""
    lines: dict[Key, int] = {}
    elements: dict[Key, int] = {}
    table: Key = ()
    for number, content in enumerate(text.split("\n"), start=1):
        if header := _HEADER.match(content):
            table = _split(header[2])
            if header[1] == "[[":
                lines.setdefault(table, number)
                elements[table] = elements.get(table, -1) + 1
                table = (*table, elements[table])
            lines.setdefault(table, number)
        elif assignment := _ASSIGNMENT.match(content):
            lines.setdefault((*table, *_split(assignment[1])), number)
    return lines


_KEY = r"(?:[A-Za-z0-9_-]+|\"[^\"]*\"|'[^']*')"
_KEYS = rf"({_KEY}(?:\s*\.\s*{_KEY})*)"
_HEADER = re.compile(rf"\s*(\[\[?)\s*{_KEYS}\s*\]")
_ASSIGNMENT = re.compile(rf"\s*{_KEYS}\s*=")


def _split(keys: str) -> Key:
    return tuple(part.strip("\"'") for part in re.findall(_KEY, keys))

"""Reads TOML files. An error is one line that names file, line and key."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from flying_vines.files.bounded import TEXT_BYTES, decoded, read_bytes

Key = tuple[str | int, ...]
"""The path to a value: names of tables and keys, and array indexes."""


MAX_DEPTH = 32
"""Tables and arrays inside each other. No file of ours has more than six."""
MAX_LENGTH = 2000
"""Of an error's text: it quotes keys and values, which may be as long as the file."""


def read_text(
    path: Path, error: Callable[[str], Exception], absent: str = "", most_bytes: int = TEXT_BYTES
) -> str:
    """The text of a file; raises `error` with one line if it cannot be read, or is larger.

    `absent` is added after "no such file"; it says what to do.
    """
    try:
        return decoded(read_bytes(path, most_bytes))
    except UnicodeDecodeError:
        reason = "cannot be read: it is not a UTF-8 text file"
    except FileNotFoundError as problem:
        reason = f"no such file{absent}" if absent else f"cannot be read: {problem.strerror}"
    except OSError as problem:
        reason = f"cannot be read: {problem.strerror}"
    raise error(f"{path}: {reason}")


def parsed(text: str, source: str, error: Callable[[str], Exception]) -> dict[str, Any]:
    """The tables of a TOML text; raises `error` with one line, with line number, if it is not TOML.

    Also if it is nested too deeply, or has an integer of more than 64 bits.
    """
    if deep := _DEEP_KEY.search(text):
        raise error(f"{source}:{text.count(chr(10), 0, deep.start()) + 1}: not TOML: nested too deeply")
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        at = re.search(r"\(at line (\d+)", str(problem))
        line = int(at[1]) if at else len(text.splitlines())
        reason = str(problem).split(" (at")[0]
        raise error(f"{source}:{line}: not TOML: {reason}") from None
    except RecursionError:
        raise error(f"{source}: not TOML: nested too deeply") from None
    except ValueError:
        # Python converts no number of more than 4300 digits.
        raise error(f"{source}: not TOML: a number has thousands of digits") from None
    for key, value in _values(tables):
        if len(key) > MAX_DEPTH:
            raise error(f"{place(text, source, key)}: not TOML: nested too deeply")
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise error(f"{located(text, source, key, 'the integer has more than 64 bits')}")
    return tables


def _values(tables: dict[str, Any]) -> Iterator[tuple[Key, Any]]:
    """All values with their keys, down to `MAX_DEPTH`; without recursion, because they may be nested."""
    waiting: list[tuple[Key, Any]] = [((), tables)]
    while waiting:
        key, value = waiting.pop()
        yield key, value
        if len(key) <= MAX_DEPTH:
            inner: Any = value.items() if isinstance(value, dict) else ()
            inner = enumerate(value) if isinstance(value, list) else inner
            waiting += [((*key, name), part) for name, part in inner]


class OneLineError(Exception):
    """An error in a file that a person wrote; the text is one line."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


def one_line(text: str) -> str:
    """Escapes unprintable characters: errors quote keys and values, which may contain line breaks.

    The middle of a very long text is left out.
    """
    text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    half = MAX_LENGTH // 2
    return text if len(text) <= MAX_LENGTH else f"{text[:half]} … {text[-half:]}"


def key_of(path: str) -> Key:
    """Parses a path that msgspec writes as `$.a.b[1]`."""
    parts = re.findall(r"\.[^.\[\]]+|\[\d+\]", path.strip("`").removeprefix("key in "))
    return tuple(int(part[1:-1]) if part.startswith("[") else part.strip(".") for part in parts)


def dotted(key: Key) -> str:
    """A key as text: `a.b[1].c`."""
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def not_finite(value: object, at: Key = ()) -> Iterator[Key]:
    """The keys of numbers that are nan or infinite."""
    inner: Any = ()
    if isinstance(value, dict):
        inner = value.items()
    elif isinstance(value, list | tuple):
        inner = enumerate(value)
    elif isinstance(value, float) and not math.isfinite(value):
        yield at
    for key, part in inner:
        yield from not_finite(part, (*at, key))


def explained(
    error: str,
    known: Callable[[Key], Sequence[str]],
    inside: Key = (),
    raw: object = None,
    range_of: Callable[[Key], str] = lambda key: "",
) -> tuple[Key, str]:
    """The key that msgspec's error `... - at `$.a.b[1]`` is about, and the reason in plain words.

    Args:
        error: the text of msgspec's error.
        known: returns the keys that a table may have, to suggest one for a mistyped key.
        inside: the key of the table that was decoded.
        raw: all tables, to quote the value.
        range_of: returns the range of the number at a key, such as " from 0 to 200"; or an empty text.
    """
    message, _, path = error.partition(" - at ")
    key = (*inside, *key_of(path))
    if unknown := re.search(r"unknown field `(.+?)`", message):
        near = difflib.get_close_matches(unknown[1], known(key), n=1)
        return (*key, unknown[1]), "unknown key" + (f"; did you mean '{near[0]}'?" if near else "")
    if missing := re.search(r"missing required field `(.+?)`", message):
        return key, f"'{missing[1]}' is missing"
    if wanted := expectation(message, _value_at(raw, key), range_of(key)):
        return key, wanted
    return key, message.replace("`", "").replace("Expected", "expected").replace("Object", "the table")


def expectation(message: str, value: object, within: str = "") -> str:
    """msgspec's "Expected `float` <= 200.0" in plain words, with the value and its range, if they are known.

    Empty for all other messages.
    """
    if expected := _EXPECTED.fullmatch(message):
        kind, bound, limit = expected.groups()
        within = within or (f" {_BOUNDS[bound]} {float(limit):g}" if bound else "")
        word = (
            str(value).lower()
            if isinstance(value, bool)
            else repr(value)
            if isinstance(value, str)
            else value
        )
        quoted = "" if value is None else f", not {word}"
        return f"must be {_KINDS.get(kind, kind)}{within}{quoted}"
    return ""


_EXPECTED = re.compile(r"Expected `(\w+)`(?: (<=|>=|<|>) ([^`]+)|, got `.*`)")
_BOUNDS = {"<=": "of at most", ">=": "of at least", "<": "below", ">": "above"}
_KINDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "a text in quotes",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
}


def _value_at(raw: object, key: Key) -> object:
    """The value at a key; None if there is none."""
    for part in key:
        try:
            raw = raw[part]  # type: ignore[index]  # mypy: any table or list
        except (LookupError, TypeError):
            return None
    return raw


def located(text: str, source: str, key: Key, reason: str) -> str:
    """The error line for a key: place, key and reason."""
    return f"{place(text, source, key)}: {dotted(key) + ': ' if key else ''}{reason}"


def place(text: str, source: str, key: Key) -> str:
    """`source:line` of a key, or of the innermost table that contains it."""
    lines = lines_of_keys(text)
    for length in range(len(key), 0, -1):
        if key[:length] in lines:
            return f"{source}:{lines[key[:length]]}"
    return source


def lines_of_keys(text: str) -> dict[Key, int]:
    """The line number of each table and key; tomllib does not report them."""
    lines: dict[Key, int] = {}
    elements: dict[Key, int] = {}
    table: Key = ()
    for number, content in enumerate(text.split("\n"), start=1):
        if header := HEADER.match(content):
            table = _split(header[2])
            if header[1] == "[[":
                lines.setdefault(table, number)
                elements[table] = elements.get(table, -1) + 1
                table = (*table, elements[table])
            lines.setdefault(table, number)
        elif assignment := ASSIGNMENT.match(content):
            lines.setdefault((*table, *_split(assignment[1])), number)
    return lines


_KEY = r"(?:[A-Za-z0-9_-]+|\"[^\"]*\"|'[^']*')"
_KEYS = rf"({_KEY}(?:\s*\.\s*{_KEY})*)"
_DEEP_KEY = re.compile(rf"(?<![\w\"'.-])(?:{_KEY}\s*\.\s*){{{MAX_DEPTH}}}")
"""tomllib takes minutes for a key of 50,000 parts."""
HEADER = re.compile(rf"\s*(\[\[?)\s*{_KEYS}\s*\]")
ASSIGNMENT = re.compile(rf"\s*{_KEYS}\s*=")


def _split(keys: str) -> Key:
    return tuple(part.strip("\"'") for part in re.findall(_KEY, keys))

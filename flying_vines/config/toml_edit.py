"""Replaces one value in a TOML text that a person wrote; all other text stays, also the comments.

Also writes values and tables as TOML.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any

from flying_vines.files.toml_text import ASSIGNMENT, HEADER, lines_of_keys

_OLD_REMARK = re.compile(r"\s*was [^;]*, measured [^;]*(; |$)")
"""A remark of an earlier replacement; the next remark replaces it."""
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def with_value(text: str, table: str, name: str, value: str, remark: str = "") -> str:
    """The text with a new value of a key (written as TOML), and a remark on its line.

    A missing key becomes the first of its table; a missing table is added at the end. A remark ("was 0.1,
    measured today") is put before the line's own comment, and replaces an earlier remark.
    """
    lines = text.split("\n")
    places = lines_of_keys(text)
    number = places.get((table, name))
    if number is not None:
        lines[number - 1 :] = _replaced(lines[number - 1 :], value, remark)
        return "\n".join(lines)
    line = _line(f"{name} = {value}", remark, 0)
    number = places.get((table,))
    if number is not None and HEADER.match(lines[number - 1]):
        lines.insert(number, line)
        return "\n".join(lines)
    return f"{text.rstrip()}\n\n[{table}]\n{line}\n"


def value_text(value: Any) -> str:
    """A value as TOML on one line; a table's None values are left out."""
    match value:
        case bool():
            return "true" if value else "false"
        case float():
            return f"{value:g}" if value == float(f"{value:g}") else repr(value)
        case str():
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case list() | tuple():
            return f"[{', '.join(map(value_text, value))}]"
        case dict():
            known = [f"{_key(key)} = {value_text(part)}" for key, part in value.items() if part is not None]
            return f"{{ {', '.join(known)} }}" if known else "{}"
    return str(value)


def table_lines(name: str, values: Mapping[str, Any]) -> list[str]:
    """A table as lines of TOML; None values are left out."""
    known = {key: value for key, value in values.items() if value is not None}
    return [f"[{name}]", *(f"{_key(key)} = {value_text(value)}" for key, value in known.items())]


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else value_text(name)


def _replaced(lines: list[str], value: str, remark: str) -> list[str]:
    """The lines from the key's line on, with the new value. The old value may span several lines."""
    assignment = ASSIGNMENT.match(lines[0])
    assert assignment is not None
    head = lines[0][: assignment.end()]
    rest, count = lines[0][assignment.end() :], 1
    while not _is_value(rest) and count < len(lines):
        rest = f"{rest}\n{lines[count]}"
        count += 1
    comment = ""
    ends = [place.start() for place in re.finditer("#", rest) if _is_value(rest[: place.start()])]
    # Comments inside an old value of several lines describe that value: drop them.
    if ends and "\n" not in rest[ends[0] :]:
        comment = _OLD_REMARK.sub("", rest[ends[0] + 1 :], count=1).strip()
    column = len(head) + ends[0] if ends and count == 1 else 0
    new_comment = "; ".join(part for part in (remark, comment) if part)
    return [_line(f"{head} {value}", new_comment, column), *lines[count:]]


def _is_value(text: str) -> bool:
    try:
        tomllib.loads(f"x ={text}")
    except tomllib.TOMLDecodeError:
        return False
    return True


def _line(assignment: str, comment: str, column: int) -> str:
    """The assignment with its comment at `column`, or two spaces behind the value."""
    return f"{assignment.ljust(column - 2)}  # {comment}" if comment else assignment

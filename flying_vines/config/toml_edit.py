"""One value of a TOML text that a person wrote, replaced: all else stays as it is, comments too."""

from __future__ import annotations

import json
import re
import tomllib
from typing import Any

from flying_vines.config.toml_text import ASSIGNMENT, HEADER, lines_of_keys

_WAS = re.compile(r"\s*was [^;]*, measured [^;]*(; |$)")
"""What a remark says, which the next one need not keep."""


def with_value(text: str, table: str, name: str, value: str, remark: str = "") -> str:
    """The text with another value of a key, as TOML writes it, and a remark on its line.

    A key that is missing is put first into its table, and a missing table at the end. A remark, as "was 0.1,
    measured today", goes before the line's own comment, in the place of an earlier one.
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
    """A value as TOML writes it on one line; of a table, what is None is left out."""
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
            known = {key: part for key, part in value.items() if part is not None}
            return f"{{ {', '.join(f'{key} = {value_text(part)}' for key, part in known.items())} }}"
    return str(value)


def _replaced(lines: list[str], value: str, remark: str) -> list[str]:
    """Lines that begin with the key's; its value may go on over several, and a comment follows."""
    assignment = ASSIGNMENT.match(lines[0])
    assert assignment is not None
    head = lines[0][: assignment.end()]
    told, count = lines[0][assignment.end() :], 1
    while not _is_value(told) and count < len(lines):
        told = f"{told}\n{lines[count]}"
        count += 1
    comment = ""
    ends = [place.start() for place in re.finditer("#", told) if _is_value(told[: place.start()])]
    # What is commented within a value of several lines belongs to what it was.
    if ends and "\n" not in told[ends[0] :]:
        comment = _WAS.sub("", told[ends[0] + 1 :], count=1).strip()
    column = len(head) + ends[0] if ends and count == 1 else 0
    said = "; ".join(part for part in (remark, comment) if part)
    return [_line(f"{head} {value}", said, column), *lines[count:]]


def _is_value(text: str) -> bool:
    try:
        tomllib.loads(f"x ={text}")
    except tomllib.TOMLDecodeError:
        return False
    return True


def _line(assignment: str, comment: str, column: int) -> str:
    """With the comment where it was, or two spaces on."""
    return f"{assignment.ljust(column - 2)}  # {comment}" if comment else assignment

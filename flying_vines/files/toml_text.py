"""Reads TOML files. An error is one line that names file, line and key."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from flying_vines.files.bounded import TEXT_BYTES, decoded, read_bytes

Key = tuple[str | int, ...]
"""The path to a value: names of tables and keys, and array indexes."""


MAX_DEPTH = 32
"""Tables and arrays inside each other. No file of ours has more than six."""
_QUOTED, _LISTED = 60, 8
"""Longest list or table that an error quotes, in characters; most keys of a table that it lists."""
MAX_LENGTH = 2000
"""Of an error's text: it quotes keys and values, which may be as long as the file."""


def read_text(
    path: Path, error: Callable[[str], Exception], absent: str = "", most_bytes: int = TEXT_BYTES
) -> str:
    """The text of a file; raises `error` with one line if it cannot be read, or is larger.

    `absent` is added after "no such file"; it says what to do.
    """
    content = b""
    try:
        content = read_bytes(path, most_bytes)
        return decoded(content)
    except UnicodeDecodeError as problem:
        reason = "cannot be read: it is not a UTF-8 text file"
        if b"\0" not in content:
            line = content.count(b"\n", 0, problem.start) + 1
            reason += f" (line {line}): save it as UTF-8"
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
        line = int(at[1]) if at else text.rstrip("\n").count("\n") + 1
        line, reason = _slip(text, line, str(problem))
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


def converted(text: str, source: str, kind: Any, error: Callable[[str], Exception]) -> Any:
    """A TOML text as the msgspec type `kind`; raises `error` with one line, also for nan and infinity."""
    raw = parsed(text, source, error)
    for key in not_finite(raw):
        raise error(located(text, source, key, "is not a finite number"))
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as problem:
        key, reason = explained(str(problem), kind, raw=raw)
        raise error(located(text, source, key, reason)) from None


def _slip(text: str, line: int, problem: str) -> tuple[int, str]:
    """The line to correct, and what to write there: tomllib says only where and why its parser stopped."""
    lines = text.split("\n")
    stopped = lines[line - 1].strip()
    if inline := re.search(r"inline table key '(.*)'", problem):
        return line, f"{inline[1]} stands twice in this line: keep one"
    if re.search("twice|overwrite|redefine|immutable", problem):
        *before, (_, key) = [found for found in _keys_in(text) if found[0] <= line] or [(line, ())]
        same = [n for n, other in before if other == key]
        same += [n for n, other in before if key[: len(other)] == other or other[: len(key)] == key]
        first = next(iter(same), line)
        if stopped.startswith("[") and stopped.startswith("[[") != lines[first - 1].strip().startswith("[["):
            name = dotted(tuple(part for part in key if isinstance(part, str)))
            return line, f"[{name}] and [[{name}]]: write it as in line {first}"
        return line, f"{dotted(key)} stands twice, first in line {first}: keep one"
    in_list = HEADER.match(stopped) and problem.startswith("Invalid value")
    if in_list or problem.startswith("Unclosed array"):
        lists = [n for n in range(1, line + 1) if ASSIGNMENT.match(lines[n - 1]) and "[" in lines[n - 1]]
        return (lists[-1] if lists else line), "the list has no closing ]"
    slips = (reason for pattern, reason in _SLIPS if re.search(pattern, stopped, re.IGNORECASE))
    return line, next(slips, "write key = value, [section] or # comment")


_SLIPS = (
    ("[“”„‘’«»]", 'write straight quotes: "…"'),
    (r"^(//|;|--|/\*)", "a comment begins with #"),
    (r"^\[[^\]\"']*\s[^\]\"']*\]", 'a name with a space needs quotes: [section."my name"]'),
    (r"^\[\[?[^\]]*$", "the section has no closing ]"),
    (r"^[\w\"'.-]+\s*:", "write = after the key, not :"),
    (r"^[^=#\[]*[^\x00-\x7f=][^=#\[]*=|^[\w.-]+\s+[\w. -]+=", "write a key with a to z, and without spaces"),
    (r"[=\[,{]\s*\{", "{ … } stands in one line, with commas between its keys and } at its end"),
    (r"=\s*=", "write one ="),
    (r"=\s*(#|$)", "the value after = is missing"),
    (r"=\s*(true|false|yes|no|on|off|none|null)\b", "write true or false, in small letters"),
    (r"=\s*[-+]?\d+,\d+\s*(#|$)", "write a point in a number, not a comma"),
    (r"=\s*[-+]?0\d", "write the number without a leading 0"),
    (r"=\s*[-+]?(\.\d|\d+\.\s*(#|$))", "write digits before and after the point"),
    (r"=\s*[-+]?[\d.]+\s*[A-Za-z%°µ/]", "write the number alone: its unit is in the key's name"),
    (r'=\s*"[^"]*\\', r"a \ in a text is written \\, or the text in single quotes"),
    (r"""=\s*("[^"]*|'[^']*)$""", "the text has no closing quote"),
    (r"=\s*[A-Za-z~/$.\\]", 'write a text in quotes: "…"'),
    (r"=\s*[-+\d]", "write one number after ="),
)
"""What people write that is not TOML, as a pattern of the line, and what to write instead."""


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
    parts = re.findall(r"\.[^.\[\]`]+|\[\d+\]", path)
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


def explained(error: str, kind: object, inside: Key = (), raw: object = None) -> tuple[Key, str]:
    """The key that msgspec's error `... - at `$.a.b[1]`` is about, and the reason in plain words.

    Our own errors begin with the key, as in "over_s: must be positive", if they are about one key of a table.

    Args:
        error: the text of msgspec's error.
        kind: the type to which `raw` was converted.
        inside: the key of the table that was decoded.
        raw: all tables, to quote the value.
    """
    message, _, path = error.partition(" - at ")
    key = (*inside, *key_of(path))
    value = _value_at(raw, key)
    expected_type = type_at(kind, key, raw)
    of_name = path.startswith("`key`")
    if ("[...]" in path or of_name) and isinstance(value, dict):
        # msgspec does not name the entry of a table whose keys are free.
        of_key, of_value = get_args(next(o for o in _options(expected_type) if get_origin(o) is dict))
        expected_type = of_key if of_name else of_value
        for name, entry in value.items():
            value = name if of_name else entry
            try:
                msgspec.convert(value, expected_type)
            except msgspec.ValidationError:
                key = (*key, name)
                break
    if unknown := re.search(r"unknown field `(.+?)`", message):
        return (*key, unknown[1]), "unknown key" + _known_instead(unknown[1], kind, key, raw)
    if missing := re.search(r"missing required field `(.+?)`", message):
        wanted = " or ".join(_described(type_at(kind, (*key, missing[1]), raw)))
        name = f"[[{missing[1]}]]" if "tables" in wanted else f"[{missing[1]}]"
        is_section = "table" in wanted and not key
        return key, f"the section {name} is missing" if is_section else f"'{missing[1]}' is missing"
    fields = {name for table in _tables(expected_type, value) for name in table.__struct_fields__}
    if (ours := re.fullmatch(r"(\w+) (must .+)", message)) and ours[1] in fields:
        return (*key, ours[1]), ours[2]
    if own := re.fullmatch(r"([a-z]\w*(?:\[\d+\])?(?:\.\w+)?): (.+)", message):
        return (*key, *key_of(f".{own[1]}")), own[2]
    if message.startswith(("Expected", "Invalid")):
        expected = " or ".join(dict.fromkeys(_described(expected_type)))
        if isinstance(value, dict) and expected.endswith("tables"):
            expected += f" ([[{key[-1]}]])"
        elif isinstance(value, list) and expected == "a table":
            expected += f" ([{key[-1]}], not [[{key[-1]}]])" if value and isinstance(value[0], dict) else ""
        quoted = "" if value is None else f", not {_quoted(value)}"
        return key, f"must be {expected or 'another value'}{quoted}"
    return key, message.replace("`", "")


def _quoted(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict | list):
        text = f"a {'table' if isinstance(value, dict) else 'list'} of {len(value)}"
        return text if len(str(value)) > _QUOTED else str(value)
    return repr(value) if isinstance(value, str) else str(value)


def _known_instead(unknown: str, kind: object, key: Key, raw: object) -> str:
    """What to write in place of an unknown key."""
    tables = _tables(type_at(kind, key, raw), _value_at(raw, key))
    fields = {name for t in tables for name in (t.__struct_config__.tag_field, *t.__struct_fields__) if name}
    if near := difflib.get_close_matches(unknown, fields, n=1):
        return f"; did you mean '{near[0]}'?"
    sections = get_type_hints(kind) if isinstance(kind, type) else {}
    for name, section in sections.items():
        if isinstance(section, type) and unknown in getattr(section, "__struct_fields__", ()):
            return f"; it belongs to [{name}]"
    return f"; the keys here are {', '.join(sorted(fields))}" if 0 < len(fields) <= _LISTED else ""


def type_at(kind: object, key: Key, raw: object = None) -> object:
    """The type of the value at a key, with its annotations; None if the key is unknown.

    `raw` tells which of several tables it is, by their tag.
    """
    for at, part in enumerate(key):
        inner: object = None
        for option in _options(kind):
            arguments = get_args(option)
            if get_origin(option) is dict:
                inner = arguments[1]
            elif get_origin(option) in (tuple, list):
                inner = arguments[0 if arguments[-1] is Ellipsis or len(arguments) == 1 else int(part)]
        tables = _tables(kind, _value_at(raw, key[:at]))
        tags = tuple(table.__struct_config__.tag for table in _tables(kind, None))
        if tables and part == tables[0].__struct_config__.tag_field:
            inner = Literal[tags]
        for table in tables:
            inner = get_type_hints(table, include_extras=True).get(str(part), inner)
        kind = inner
    return kind


def _tables(kind: object, value: object) -> list[Any]:
    """The tables of a type; of several only the one that a value's tag names."""
    tables = [option for option in _options(kind) if hasattr(option, "__struct_config__")]
    if isinstance(value, dict):
        named = [t for t in tables if value.get(t.__struct_config__.tag_field) == t.__struct_config__.tag]
        return named or tables
    return tables


def _options(kind: object) -> list[Any]:
    """The types of a union, without `Annotated`; None is no value of a TOML file."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _options(arguments[0])
    if origin in (Union, types.UnionType):
        return [option for member in arguments for option in _options(member)]
    return [] if kind in (None, type(None)) else [kind]


def _described(kind: object) -> Iterator[str]:
    """What a value of this type may be, in plain words."""
    plain = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    origin, arguments = get_origin(plain), get_args(plain)
    if origin in (Union, types.UnionType):
        for member in arguments:
            yield from _described(member)
    elif origin is Literal:
        words = [word for word in arguments if isinstance(word, str)]
        yield f"{'one of ' if len(words) > 1 else ''}{', '.join(words)}"
    elif origin is tuple and Ellipsis not in arguments:
        yield f"a list of {len(arguments)} values"
    elif origin in (tuple, list):
        yield f"a list{range_of(kind) or ' of'} {'tables' if _tables(arguments[0], None) else 'values'}"
    elif plain not in (None, type(None)):
        yield _KINDS.get(plain, "a table") + range_of(kind)


def range_of(kind: object) -> str:
    """The range of a number's type as text, such as " from 0.001 to 1000"; empty if it has none."""
    for meta in getattr(kind, "__metadata__", ()):
        if meta.description is not None:
            return f" {meta.description}"
        if meta.ge is not None and meta.le is not None:
            return f" from {meta.ge:.10g} to {meta.le:.10g}"
        if meta.gt is not None:
            return f" above {meta.gt:g}" + (f", up to {meta.le:g}" if meta.le is not None else "")
        if meta.max_length is not None:
            return f" of {f'{meta.min_length} to' if meta.min_length else 'at most'} {meta.max_length}"
    return ""


_KINDS: dict[object, str] = {
    int: "a whole number",
    float: "a number",
    str: "a text in quotes",
    bool: "true or false",
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
    for number, key in _keys_in(text):
        lines.setdefault(key, number)
    return lines


def _keys_in(text: str) -> Iterator[tuple[int, Key]]:
    elements: dict[Key, int] = {}
    table: Key = ()
    for number, content in enumerate(text.split("\n"), start=1):
        if header := HEADER.match(content):
            table = _split(header[2])
            if header[1] == "[[":
                yield number, table
                elements[table] = elements.get(table, -1) + 1
                table = (*table, elements[table])
            yield number, table
        elif assignment := ASSIGNMENT.match(content):
            yield number, (*table, *_split(assignment[1]))


_KEY = r"(?:[A-Za-z0-9_-]+|\"[^\"]*\"|'[^']*')"
_KEYS = rf"({_KEY}(?:\s*\.\s*{_KEY})*)"
_DEEP_KEY = re.compile(rf"(?<![\w\"'.-])(?:{_KEY}\s*\.\s*){{{MAX_DEPTH}}}")
"""tomllib takes minutes for a key of 50,000 parts."""
HEADER = re.compile(rf"\s*(\[\[?)\s*{_KEYS}\s*\]")
ASSIGNMENT = re.compile(rf"\s*{_KEYS}\s*=")


def _split(keys: str) -> Key:
    return tuple(part.strip("\"'") for part in re.findall(_KEY, keys))

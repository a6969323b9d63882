"""The tables of docs/commands.md and docs/configuration.md, made of the parser and of the configuration.

A page marks the place of a table with `<!-- options: mission check -->` … `<!-- end -->`; what stands between
the two is made here, and all else is written by people. After a change of an option or a key:

    .venv/bin/python tests/docs/references.py
"""

from __future__ import annotations

import argparse
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import get_args

import msgspec
from msgspec import inspect

from flying_vines.cli.main import _parser
from flying_vines.config import config as configuration
from flying_vines.config.config import CARRIERS, Config
from flying_vines.config.toml_edit import value_text
from flying_vines.config.toml_text import lines_of_keys
from flying_vines.vehicle.component.settings import SETTINGS
from flying_vines.vehicle.radio.switch import BOUNDARIES_US
from flying_vines.vine.profile import Segment

DOCS = Path(__file__).parents[2] / "docs"
PAGES = (DOCS / "commands.md", DOCS / "configuration.md")

BLOCK = re.compile(r"(?P<mark><!-- (?P<kind>\w+): (?P<name>[\w. -]+) -->\n).*?(?=<!-- end -->)", re.DOTALL)
BEHIND = re.compile(r"""=\s*(?:"[^"]*"|[^"#\[]+|\[[^#]*\])\s*#\s*(.*)""")
UNITS = {
    "_kPa_s_per_SL": "kPa·s/SL",
    "_kPa_per_s": "kPa/s",
    "_kPa": "kPa",
    "_Hz": "Hz",
    "_MB": "MB",
    "_us": "µs",
    "_cycles": "cycles",
    "_L": "L",
    "_m": "m",
    "_s": "s",
}
"""By how a key ends; the longest first."""


def filled(page: str) -> str:
    """A page with each of its tables made anew."""

    def again(block: re.Match[str]) -> str:
        rows = TABLES[block["kind"]](block["name"])
        return block["mark"] + "\n".join(rows) + "\n"

    return BLOCK.sub(again, page)


def marked(page: str, kind: str) -> list[str]:
    """The names of a page's tables of a kind, in its order."""
    return [block["name"] for block in BLOCK.finditer(page) if block["kind"] == kind]


# Commands.


def commands() -> dict[str, argparse.ArgumentParser]:
    """Each command that can be given, as `mission check`, and what reads its arguments."""
    return dict(_commands(_parser(), ""))


def _commands(parser: argparse.ArgumentParser, name: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if name and not any(action.required for action in below):
        yield name, parser
    for action in below:
        for word, inner in action.choices.items():
            yield from _commands(inner, f"{name} {word}".strip())


def arguments(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """What a command takes, but for help and for the word of a further command."""
    passed_over = (argparse._HelpAction, argparse._SubParsersAction)
    return [action for action in parser._actions if not isinstance(action, passed_over)]


def options(name: str) -> list[str]:
    """A command's arguments and options, a row each."""
    found = arguments(commands()[name])
    return ["| given | means |", "| --- | --- |", *(_row(f"`{_given(a)}`", _meant(a)) for a in found)]


def _given(action: argparse.Action) -> str:
    value = "" if action.nargs == 0 else str(action.metavar or action.dest.upper())
    if action.nargs in ("*", "+"):
        value += " …"
    if action.nargs == "?" and action.option_strings:
        value = f"[{value}]"
    if not action.option_strings:
        return value if action.required else f"[{value}]"
    return f"{action.option_strings[-1]} {value}".strip()


def _meant(action: argparse.Action) -> str:
    words = action.help or ""
    if action.option_strings and action.required:
        words += "; must be given"
    if action.choices:
        what, _, by_default = words.partition("(")
        choices = " or ".join(f"`{choice}`" for choice in action.choices)
        words = f"{what and what.strip() + ': '}{choices} ({by_default}"
    return words


# Keys.


def tables() -> dict[str, type[msgspec.Struct]]:
    """The configuration's tables that have one value a key, by name."""
    built_in = configuration.default()
    values = {name: getattr(built_in, name) for name in Config.__struct_fields__}
    return {name: type(value) for name, value in values.items() if isinstance(value, msgspec.Struct)}


def keys(name: str) -> list[str]:
    """A table's keys, a row each."""
    rows = ["| key | may be | default | means |", "| --- | --- | --- | --- |"]
    comments = comments_of(configuration.default_text())
    raw = tomllib.loads(configuration.default_text())[name]
    settings = {(setting.table, setting.key): setting for setting in SETTINGS}
    for field in fields(tables()[name]):
        meant = comments[name, field.name]
        if setting := settings.get((name, field.name)):
            meant += f". In the field: `{setting.name}`" + (", while bent, too" if setting.in_flight else "")
        rows.append(_row(f"`{field.name}`", allowed(field), f"`{value_text(raw[field.name])}`", meant))
    return rows


def fields(table: type[msgspec.Struct]) -> tuple[inspect.Field, ...]:
    """The keys of a table, with what their values may be."""
    info = inspect.type_info(table)
    assert isinstance(info, inspect.StructType)
    return info.fields


def allowed(field: inspect.Field) -> str:
    """What a key's value may be, in words; of a number the range and the unit that ends the key's name."""
    kind = field.type
    if isinstance(kind, inspect.UnionType):
        return " or ".join(allowed(msgspec.structs.replace(field, type=part)) for part in kind.types)
    if isinstance(kind, inspect.FloatType | inspect.IntType):
        unit = next((f" {unit}" for end, unit in UNITS.items() if field.name.endswith(end)), "")
        whole = ", whole" if isinstance(kind, inspect.IntType) else ""
        return _range(kind) + unit + whole
    if isinstance(kind, inspect.LiteralType):
        return " or ".join(f"`{value_text(word)}`" for word in kind.values)
    if isinstance(kind, inspect.BoolType):
        return "`true` or `false`"
    if isinstance(kind, inspect.VarTupleType):
        return "list of " + {
            inspect.StrType: "names",
            inspect.TupleType: "pairs of numbers",
        }.get(type(kind.item_type), "words")
    assert isinstance(kind, inspect.StrType), field
    return "text"


def _range(kind: inspect.FloatType | inspect.IntType) -> str:
    if kind.gt is not None:
        return f"above {kind.gt:g}" + ("" if kind.le is None else f", to {kind.le:g}")
    if kind.ge is None:
        return "number"
    return f"{kind.ge:g} or more" if kind.le is None else f"{kind.ge:g} … {kind.le:g}"


def comments_of(text: str) -> dict[tuple[str, str], str]:
    """What a profile's text says of each key, in the comment behind it and on indented lines below it."""
    lines = text.splitlines()
    found = {}
    for key, number in lines_of_keys(text).items():
        if len(key) != 2:
            continue
        said = BEHIND.findall(lines[number - 1])
        for line in lines[number:]:
            if not (more := re.match(r"\s+#\s*(.*)", line)):
                break
            said.append(more[1])
        found[str(key[0]), str(key[1])] = " ".join(said)
    return found


# Items, switch and profiles.


def carriers(name: str) -> list[str]:
    """The names that `command` of an item may have, and their MAVLink numbers."""
    rows = (_row(f"`{word}`", str(number)) for word, number in CARRIERS.items())
    return ["| command | MAV_CMD |", "| --- | --- |", *rows]


def borders(name: str) -> list[str]:
    """Between the positions of the switch."""
    rows = (
        _row(str(positions), ", ".join(f"{border:g}" for border in between))
        for positions, between in BOUNDARIES_US.items()
    )
    return ["| positions | borders, µs |", "| --- | --- |", *rows]


def segments(name: str) -> list[str]:
    """The kinds of a profile's segments: their keys, and what they do."""
    rows = ["| kind | keys | does |", "| --- | --- | --- |"]
    for segment in get_args(Segment):
        words = ", ".join(
            f"`{field.name}`" + ("" if field.required or field.default is None else f" = {field.default:g}")
            for field in fields(segment)
        )
        rows.append(_row(f"`{segment.__struct_config__.tag}`", words, segment.__doc__.removesuffix(".")))
    return rows


def _row(*cells: str) -> str:
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


TABLES: Mapping[str, Callable[[str], list[str]]] = {
    "options": options,
    "keys": keys,
    "borders": borders,
    "carriers": carriers,
    "segments": segments,
}
"""What makes the tables of each kind, out of a table's name."""


if __name__ == "__main__":
    for path in PAGES:
        path.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")
        print(f"Wrote {path}")

"""Generates the tables of docs/ that the code contains: options, keys, parameters, faults.

A page marks a table with `<!-- options: mission check -->` … `<!-- end -->`. This script writes the text
between the two. Run it after a change of an option, a key or a fault:

    .venv/bin/python tests/docs/references.py
"""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import get_args

import msgspec
from msgspec import inspect

# Run as a script, this file's own folder is on the path, but not tests/.
sys.path.insert(0, str(Path(__file__).parents[1]))

from fault_catalogue.catalogue import SECTIONS, Row

from flying_vines.cli.main import _parser
from flying_vines.config import config
from flying_vines.config.config import ITEM_COMMANDS, Config
from flying_vines.config.toml_edit import value_text
from flying_vines.doctor.vehicle import USES
from flying_vines.files.toml_text import lines_of_keys
from flying_vines.vehicle.autopilots.ardupilot import STREAM_GROUPS
from flying_vines.vehicle.component.parameter_table import SETTINGS, bounds, value_of
from flying_vines.vehicle.radio.switch import BOUNDARIES_US
from flying_vines.vehicle.streams import Streams
from flying_vines.vine.profile import Segment

DOCS = Path(__file__).parents[2] / "docs"
NAMES = ("commands", "configuration", "mavlink", "faults", "doctor")
PAGES = tuple(DOCS / f"{name}.md" for name in NAMES)

BLOCK = re.compile(r"(?P<mark><!-- (?P<kind>\w+): (?P<name>[\w., -]+) -->\n).*?(?=<!-- end -->)", re.DOTALL)
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
"""Units by the end of a key; the longest first."""


def filled(page: str) -> str:
    """A page with all its tables generated anew."""

    def again(block: re.Match[str]) -> str:
        rows = TABLES[block["kind"]](block["name"])
        return block["mark"] + "\n".join(rows) + "\n"

    return BLOCK.sub(again, page)


def marked(page: str, kind: str) -> list[str]:
    """The names of a page's tables of a kind, in the order of the page."""
    return [block["name"] for block in BLOCK.finditer(page) if block["kind"] == kind]


# Commands.


def commands() -> dict[str, argparse.ArgumentParser]:
    """Each command, as `mission check`, and the parser of its arguments."""
    return dict(_commands(_parser(), ""))


def _commands(parser: argparse.ArgumentParser, name: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if name and not any(action.required for action in below):
        yield name, parser
    for action in below:
        for word, inner in action.choices.items():
            yield from _commands(inner, f"{name} {word}".strip())


def arguments(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """The arguments of a command, except help and subcommands."""
    passed_over = (argparse._HelpAction, argparse._SubParsersAction)
    return [action for action in parser._actions if not isinstance(action, passed_over)]


def options(name: str) -> list[str]:
    """The options of a command in one line; its `--help` explains them."""
    return [" · ".join(f"`{_given(action)}`" for action in arguments(commands()[name]))]


def _given(action: argparse.Action) -> str:
    value = "" if action.nargs == 0 else str(action.metavar or action.dest.upper())
    if action.choices:
        value = "|".join(map(str, action.choices))
    if action.nargs in ("*", "+"):
        value += " …"
    if action.nargs == "?" and action.option_strings:
        value = f"[{value}]"
    if not action.option_strings:
        return value if action.required else f"[{value}]"
    return f"{action.option_strings[-1]} {value}".strip()


# Keys.


def tables() -> dict[str, type[msgspec.Struct]]:
    """The configuration's tables with one value for each key, by name."""
    built_in = config.default()
    values = {name: getattr(built_in, name) for name in Config.__struct_fields__}
    return {name: type(value) for name, value in values.items() if isinstance(value, msgspec.Struct)}


def keys(name: str) -> list[str]:
    """The keys of a table, one row each."""
    rows = ["| key | may be | default | means |", "| --- | --- | --- | --- |"]
    comments = comments_of(config.default_text())
    raw = tomllib.loads(config.default_text())[name]
    settings = {(setting.table, setting.key): setting for setting in SETTINGS}
    for field in fields(tables()[name]):
        meant = comments[name, field.name]
        if setting := settings.get((name, field.name)):
            meant += f". In the field: `{setting.name}`" + (", also while bent" if setting.in_flight else "")
        rows.append(_row(f"`{field.name}`", allowed(field), f"`{value_text(raw[field.name])}`", meant))
    return rows


def fields(table: type[msgspec.Struct]) -> tuple[inspect.Field, ...]:
    """The keys of a table with their types."""
    info = inspect.type_info(table)
    assert isinstance(info, inspect.StructType)
    return info.fields


def allowed(field: inspect.Field) -> str:
    """The allowed values of a key in words; for a number the range and the unit at the end of the key's
    name."""
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
    if isinstance(kind, inspect.DictType):
        return "table"
    assert isinstance(kind, inspect.StrType), field
    return "text"


def _range(kind: inspect.FloatType | inspect.IntType) -> str:
    if kind.gt is not None:
        return f"above {kind.gt:g}" + ("" if kind.le is None else f", to {kind.le:g}")
    if kind.ge is None:
        return "number"
    return f"{kind.ge:g} or more" if kind.le is None else f"{kind.ge:g} … {kind.le:.12g}"


def comments_of(text: str) -> dict[tuple[str, str], str]:
    """The comment on each key in a configuration's text: behind the key, and on indented lines below."""
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


def item_commands(name: str) -> list[str]:
    """The names that `command` of an item may have, and their MAVLink numbers."""
    rows = (_row(f"`{word}`", str(number)) for word, number in ITEM_COMMANDS.items())
    return ["| command | MAV_CMD |", "| --- | --- |", *rows]


def borders(name: str) -> list[str]:
    """Borders between the positions of the switch."""
    rows = (
        _row(str(positions), ", ".join(f"{border:g}" for border in between))
        for positions, between in BOUNDARIES_US.items()
    )
    return ["| positions | borders, µs |", "| --- | --- |", *rows]


def segments(name: str) -> list[str]:
    """The kinds of profile segments, with their keys and meaning."""
    rows = ["| kind | keys | does |", "| --- | --- | --- |"]
    for segment in get_args(Segment):
        words = ", ".join(
            f"`{field.name}`" + ("" if field.required or field.default is None else f" = {field.default:g}")
            for field in fields(segment)
        )
        rows.append(_row(f"`{segment.__struct_config__.tag}`", words, segment.__doc__.removesuffix(".")))
    return rows


# Parameters and faults.


def parameters(name: str) -> list[str]:
    """The parameters that a pilot may change in the field."""
    base = config.default()
    rows = [
        "| parameter | key of the configuration | default | may be | |",
        "| --- | --- | --- | --- | --- |",
    ]
    for setting in SETTINGS:
        least, most = bounds(setting, base)
        allowed = f"{least:g} … {most:g}"
        if setting.guard != "none":
            allowed = f"at {'most' if setting.guard == 'max' else 'least'} the configured value ({allowed})"
        key = f"`{setting.table}.{setting.key}`"
        rows.append(_row(f"`{setting.name}`", key, f"{value_of(setting, base):g}", allowed, setting.doc))
    return rows


def streams(name: str) -> list[str]:
    """The messages that the service requests."""
    rows = ["| message | a second | needed for | on ArduPilot |", "| --- | --- | --- | --- |"]
    for message, wanted in Streams(config.default().vehicle.rc_rate_Hz).wanted(0.0).items():
        need = f"**{USES[message]}**" if wanted.essential else USES[message]
        rows.append(_row(message, f"{wanted.rate_Hz:g}", need, f"`SRn_{STREAM_GROUPS[message]}`"))
    return rows


def faults(name: str) -> list[str]:
    """The rows of a section of the fault catalogue."""
    head = "| fault | seen by | safe within, ms | measured, ms | safe state | the pilot reads | cleared by |"
    return [head, "| --- | --- | ---: | ---: | --- | --- | --- |", *map(_fault, SECTIONS[name])]


def _fault(row: Row) -> str:
    state = row.safe_state
    if row.left_kPa:
        state += f" ({row.left_kPa:g} kPa)"
    if row.highest_kPa is not None:
        state += f"; **up to {row.highest_kPa:g} kPa before**"
    numbers = (str(ms) if ms is not None else "–" for ms in (row.allowed_ms, row.measured_ms))
    text = f"“{row.pilot_text}”" if row.pilot_text else "–"
    return _row(row.fault, row.seen_by, *numbers, state, text, row.cleared.value)


def _row(*cells: str) -> str:
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


TABLES: Mapping[str, Callable[[str], list[str]]] = {
    "options": options,
    "keys": keys,
    "borders": borders,
    "item_commands": item_commands,
    "segments": segments,
    "parameters": parameters,
    "streams": streams,
    "faults": faults,
}
"""For each kind of table: the function that makes it from its name."""


if __name__ == "__main__":
    for path in PAGES:
        path.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")
        print(f"Wrote {path}")

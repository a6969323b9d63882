"""The reference tables list everything in the code, with an example of each command and true ranges."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pytest
from doctor.known_lines import every_line
from fault_catalogue.catalogue import SECTIONS
from hypothesis import given, settings
from hypothesis import strategies as st

from docs.references import BLOCK, PAGES, arguments, commands, filled, marked, tables
from examples import examples
from flying_vines.config import config
from flying_vines.config.config import Config, ConfigError, ItemConfig, TriggerConfig
from flying_vines.doctor.computer import MIN_FREE_MB
from flying_vines.vine.profile import PressureProfile

COMMANDS, CONFIGURATION, _, FAULTS, DOCTOR = (page.read_text(encoding="utf-8") for page in PAGES)
WRITTEN_BY_PEOPLE = {"items": ItemConfig, "profiles": PressureProfile, "triggers": TriggerConfig}
ROW = re.compile(r"^\| `(\w+)` \| ([^|]*?) \|", re.MULTILINE)
RANGE = re.compile(
    r"(?:above (?P<above>[\d.]+)(?:, to (?P<to>[\d.]+))?|(?P<least>[\d.]+) (?:or more|… (?P<most>[\d.]+)))"
    r"[^,]*(?P<whole>, whole)?"
)
PROFILES = config.default_text()[config.default_text().index("[profiles.straight]") :]


def under(page: str, name: str) -> str:
    """The text of a page below the heading of a command or table."""
    heading = rf"^#+ (?:{name}|`\[+{name}\]+`)$"
    below = re.split(heading, page, maxsplit=1, flags=re.MULTILINE)[1]
    return re.split(r"^#+ ", below, maxsplit=1, flags=re.MULTILINE)[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_tables_are_as_they_are_made(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert filled(text) == text, "make them anew: .venv/bin/python tests/docs/references.py"


def test_every_command_has_its_heading_and_its_options_once() -> None:
    assert sorted(marked(COMMANDS, "options")) == sorted(commands())
    for name in commands():
        assert COMMANDS.count(f"\n### {name}\n") == 1, name


def test_every_key_has_its_row() -> None:
    assert marked(CONFIGURATION, "keys") == list(tables())
    assert {*tables(), *WRITTEN_BY_PEOPLE} == set(Config.__struct_fields__)
    for name, table in WRITTEN_BY_PEOPLE.items():
        assert {key for key, _ in ROW.findall(under(CONFIGURATION, name))} >= set(table.__struct_fields__), (
            name
        )


def test_every_fault_has_its_table() -> None:
    assert marked(FAULTS, "faults") == list(SECTIONS)
    assert all(f"\n## {title}\n" in FAULTS for title in SECTIONS)


def test_all_that_the_doctor_looks_at_has_its_row() -> None:
    """Its row has text in the column of each possible verdict, and in no other."""
    stated = {
        name: {verdict for verdict, words in (("bad", bad), ("warning", warning)) if words.strip()}
        for names, bad, warning in re.findall(r"^\| (\w[^|]*) \|([^|]*)\|([^|]*)\|$", DOCTOR, re.MULTILINE)
        for name in names.split(", ")
    }
    del stated["looked at"]
    given: dict[str, set[str]] = {}
    for line in every_line():
        if line.do:
            name = line.check.replace("{name}", "messages")
            for check in {name.replace("{which}", which) for which in ("phloSAR", "vehicle")}:
                given.setdefault(check, set()).add(line.verdict)
    assert stated == given


def test_the_memory_that_the_doctor_requires_is_stated() -> None:
    assert f"less than {MIN_FREE_MB:.0f} MB free" in DOCTOR


def test_every_option_and_key_has_a_description() -> None:
    for name, parser in commands().items():
        assert all(action.help for action in arguments(parser)), name
    for block in BLOCK.finditer(CONFIGURATION):
        assert "|  |" not in block[0], block["name"]


def test_every_command_has_an_example() -> None:
    for name in commands():
        assert re.search(rf"^    (sudo )?flying-vines {name}\b", under(COMMANDS, name), re.MULTILINE), name


def test_the_examples_of_the_configuration_can_be_flown() -> None:
    examples = re.findall(r"^```toml\n(.*?)^```", CONFIGURATION, re.MULTILINE | re.DOTALL)
    assert len(examples) == len(WRITTEN_BY_PEOPLE)
    config.parse("\n".join([config.default_text(), *examples]), "my.toml")


@dataclass(frozen=True)
class Stated:
    """The range of a number on the page."""

    table: str
    key: str
    least: float
    most: float | None
    may_be_least: bool
    whole: bool

    def text(self, value: float) -> str:
        """A configuration with this value."""
        head = "[profiles.x]\nsegments = [{kind = 'step', to_kPa = 0}]" if self.table == "profiles" else ""
        return f"{head or f'[{self.table}]'}\n{self.key} = {value}\n{PROFILES}"


def stated() -> Iterator[Stated]:
    for table in (*tables(), "profiles"):
        for key, may_be in ROW.findall(under(CONFIGURATION, table)):
            if found := RANGE.fullmatch(may_be):
                most = found["to"] or found["most"]
                yield Stated(
                    table,
                    key,
                    least=float(found["above"] or found["least"]),
                    most=float(most) if most else None,
                    may_be_least=found["above"] is None,
                    whole=found["whole"] is not None,
                )


STATED = list(stated())


def test_every_number_has_its_range() -> None:
    numbers = {
        (table, key)
        for table in tables()
        for key, value in msgspec.structs.asdict(getattr(config.default(), table)).items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }
    assert numbers <= {(number.table, number.key) for number in STATED}


def why_not(text: str) -> str:
    """Why a configuration is refused; empty if it is valid."""
    try:
        config.parse(text, "my.toml")
    except ConfigError as error:
        return str(error)
    return ""


@given(number=st.sampled_from(STATED), by=st.floats(1e-6, 1e6), data=st.data())
@settings(max_examples=examples(400), deadline=None)
def test_a_value_outside_its_range_is_refused(number: Stated, by: float, data: st.DataObject) -> None:
    step = float(round(by) + 1) if number.whole else by
    too_low = (
        number.least - step if number.may_be_least else number.least - data.draw(st.sampled_from([0, step]))
    )
    value = too_low if number.most is None or data.draw(st.booleans()) else number.most + step
    why = why_not(number.text(int(value) if number.whole else value))
    assert number.key in why or f"{number.table}.x" in why, (number, value, why)


@given(number=st.sampled_from(STATED), share=st.floats(0, 1), data=st.data())
@settings(max_examples=examples(400), deadline=None)
def test_a_value_inside_it_is_not_refused_for_itself(
    number: Stated, share: float, data: st.DataObject
) -> None:
    most = 1e6 if number.most is None else number.most
    value = number.least + share * (most - number.least)
    if number.whole:
        value = round(value)
    elif value == number.least and not number.may_be_least:
        value = most
    why = why_not(number.text(value))
    # Another key may still not allow it, as a limit below the curve.
    assert "expected" not in why and "must be above 0" not in why and "must be 1 to" not in why, why

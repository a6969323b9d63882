"""Replacing one value of a configuration changes this value and nothing else."""

from __future__ import annotations

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.config import config
from flying_vines.config.toml_edit import value_text, with_value

REMARK = "was 0.1, measured 2026-11-22: 0.102 … 0.107"
NUMBERS = [
    (table.__name__.removesuffix("Config").lower(), name)
    for table in (config.PneumaticsConfig, config.LimitsConfig, config.VineConfig, config.LossesConfig)
    for name in table.__struct_fields__
]


@given(st.sampled_from(NUMBERS), st.floats(-1e9, 1e9))
def test_one_value_changes_and_no_other(key: tuple[str, str], number: float) -> None:
    table, name = key
    text = config.default_text()
    edited = with_value(text, table, name, value_text(number), REMARK)
    expected = tomllib.loads(text)
    expected[table][name] = tomllib.loads(f"x = {value_text(number)}")["x"]
    assert tomllib.loads(edited) == expected
    assert float(expected[table][name]) == number
    changed = [line for line in edited.split("\n") if line not in text.split("\n")]
    assert len(changed) == 1
    assert REMARK in changed[0]


def test_the_comment_stays_where_it_was_and_an_earlier_remark_is_replaced() -> None:
    text = "[limits]\nmax_kPa = 20.7                  # no setpoint is above it\n"
    once = with_value(text, "limits", "max_kPa", "19", "was 20.7, measured on Monday")
    twice = with_value(once, "limits", "max_kPa", "18.5", "was 19, measured on Tuesday")
    assert twice == (
        "[limits]\nmax_kPa = 18.5                  # was 19, measured on Tuesday; no setpoint is above it\n"
    )


@pytest.mark.parametrize(
    ("text", "edited"),
    [
        ("[a]  # of a\ny = 1\n", "[a]  # of a\nx = [2]  # r\ny = 1\n"),
        ("[b]\ny = 1\n", "[b]\ny = 1\n\n[a]\nx = [2]  # r\n"),
        ("[a]\nx = [ # one\n  1, # two\n]  # three\ny = 1", "[a]\nx = [2]  # r; three\ny = 1"),
        ("[a]\nx = '#1' # two", "[a]\nx = [2] # r; two"),
        ("a.x = 1", "a.x = [2]  # r"),
    ],
    ids=["no key", "no table", "several lines", "no comment", "dotted"],
)
def test_wherever_it_stands(text: str, edited: str) -> None:
    found = with_value(text, "a", "x", "[2]", "r")
    assert tomllib.loads(found)["a"]["x"] == [2]
    assert found.replace("  #", " #") == edited.replace("  #", " #")


@given(st.text())
def test_a_string_is_one(text: str) -> None:
    assert tomllib.loads(f"x = {value_text(text)}")["x"] == text

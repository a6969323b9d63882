"""The page on MAVLink says what the code has: every parameter with its bounds, every command, every value."""

from __future__ import annotations

from pathlib import Path

from flying_vines.config import config
from flying_vines.core.events import ToVehicle
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.component.settings import SETTINGS, bounds, value_of
from flying_vines.vehicle.triggers import CHOICES

PAGE = (Path(__file__).parents[2] / "docs" / "mavlink.md").read_text(encoding="utf-8")


def parameter_rows() -> list[str]:
    profile = config.default()
    rows = ["| parameter | key of the profile | default | may be | |", "| --- | --- | --- | --- | --- |"]
    for setting in SETTINGS:
        least, most = bounds(setting, profile)
        allowed = f"{least:g} … {most:g}"
        if setting.guard != "none":
            allowed = f"at {setting.guard} the profile's ({allowed})"
        rows.append(
            f"| `{setting.name}` | `{setting.table}.{setting.key}` | {value_of(setting, profile):g} "
            f"| {allowed} | {setting.doc} |"
        )
    return rows


def test_the_table_of_parameters_is_the_code_s() -> None:
    assert "\n".join(parameter_rows()) in PAGE


def test_every_command_is_there() -> None:
    for command, choices in CHOICES.items():
        assert f"({command})" in PAGE
        block = PAGE[PAGE.index(f"({command})") :]
        for number, (name, intent) in enumerate(choices):
            assert intent is None or f"| {number} | {name.split()[0]}" in block, name


def test_every_named_value_is_there() -> None:
    sent = (
        action.message
        for action in SimulatedFlight(config.default()).run(5.0)
        if isinstance(action, ToVehicle)
    )
    names = {message.name for message in sent if message.get_type() == "NAMED_VALUE_FLOAT"}
    assert len(names) == 5
    assert all(f"| `{name}` |" in PAGE for name in names)

"""The page on MAVLink lists every command and every value."""

from __future__ import annotations

from pathlib import Path

from flying_vines.config import config
from flying_vines.core.events import ToVehicle
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.component.telemetry import VALUE_NAMES
from flying_vines.vehicle.triggers import CHOICES

PAGE = (Path(__file__).parents[2] / "docs" / "mavlink.md").read_text(encoding="utf-8")


def test_every_command_is_documented() -> None:
    for command, choices in CHOICES.items():
        assert f"({command})" in PAGE
        block = PAGE[PAGE.index(f"({command})") :]
        for number, (name, intent) in enumerate(choices):
            assert intent is None or f"| {number} | {name.split()[0]}" in block, name


def test_every_named_value_is_documented() -> None:
    sent = (
        action.message
        for action in SimulatedFlight(config.default()).run(5.0)
        if isinstance(action, ToVehicle)
    )
    names = {message.name for message in sent if message.get_type() == "NAMED_VALUE_FLOAT"}
    assert names == set(VALUE_NAMES)
    assert all(len(name) <= 10 for name in names)
    assert all(f"| `{name}` |" in PAGE for name in names)

"""Imports only go from a room to a lower one, and no modules import each other in a circle."""

from __future__ import annotations

from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from module_imports import imported, module_name

ROOT = Path(__file__).parents[1]
LEVELS = (
    ("files",),
    ("physics", "vine", "firmware_link"),
    ("config", "plots"),
    ("vehicle", "supply"),
    ("core",),
    ("record", "gateway", "missions"),
    ("terminal",),
    ("service", "install"),
    ("simulation", "doctor"),
    ("identification",),
    ("calibration", "studies"),
    ("cli", "api"),
)
"""The rooms, the lowest first. A room may import those of lower levels."""
FLY = {
    *("vehicle", "supply", "core", "record", "gateway", "terminal", "service", "install", "doctor"),
    "missions",
}
LAB = {"simulation", "identification", "calibration", "studies"}
LEVEL = {room: level for level, rooms in enumerate(LEVELS) for room in rooms}


def room_of(module: str) -> str:
    package, _, rest = module.partition(".")
    return rest.partition(".")[0] if package == "flying_vines" else package


def read(root: Path) -> dict[str, set[str]]:
    folders = ("flying_vines", "firmware_link", "missions")
    paths = {
        module_name(path.relative_to(root)): path
        for folder in folders
        for path in (root / folder).rglob("*.py")
    }
    return {
        name: imported(path.read_text(encoding="utf-8"), set(paths) - {"flying_vines"})
        for name, path in paths.items()
        if name not in ("flying_vines", "flying_vines.__main__")
    }


@cache
def graph() -> dict[str, set[str]]:
    return read(ROOT)


def upward(imports: dict[str, set[str]]) -> list[str]:
    return [
        f"{module} imports {other}"
        for module, others in imports.items()
        for other in sorted(others)
        if room_of(module) != room_of(other) and LEVEL[room_of(module)] <= LEVEL[room_of(other)]
    ]


def test_each_room_has_a_level() -> None:
    assert {room_of(module) for module in graph()} == set(LEVEL)


def test_imports_between_rooms_go_downward() -> None:
    assert upward(graph()) == []


def from_lab_to_fly(imports: dict[str, set[str]]) -> list[str]:
    return [
        f"{module} imports {other}"
        for module, others in imports.items()
        for other in sorted(others)
        if room_of(module) in FLY and room_of(other) in LAB
    ]


def test_fly_imports_nothing_from_lab() -> None:
    assert from_lab_to_fly(graph()) == []


def test_an_import_from_lab_to_fly_is_found() -> None:
    assert from_lab_to_fly({"flying_vines.core.core": {"flying_vines.studies.design"}}) == [
        "flying_vines.core.core imports flying_vines.studies.design"
    ]


def test_an_upward_import_is_found() -> None:
    assert upward({"flying_vines.physics.rig": {"flying_vines.cli.main"}}) == [
        "flying_vines.physics.rig imports flying_vines.cli.main"
    ]


def test_no_modules_import_each_other_in_a_circle() -> None:
    try:
        tuple(TopologicalSorter(graph()).static_order())
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


@pytest.mark.parametrize(
    "source", ["import pkg.a", "from pkg import a", "def f():\n    from pkg.a import x", "import pkg.a as b"]
)
def test_every_form_of_import_is_read(source: str) -> None:
    assert imported(source, {"pkg", "pkg.a"}) == {"pkg.a"}

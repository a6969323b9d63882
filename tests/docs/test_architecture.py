"""The tree in docs/architecture.md lists every module or its folder, and nothing else."""

from __future__ import annotations

import re
from pathlib import PurePath

import pytest

from docs.documented_commands import ROOT

PACKAGES = ("flying_vines", "firmware_link", "missions")
TREE = (
    (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").partition("```\n")[2].partition("```")[0]
)
NAMED = {name for name in re.findall(r"[\w./-]+", TREE) if re.search(r"\w(\.py|/)$", name)}
FOLDERS = {PurePath(name).name for name in NAMED if name.endswith("/")}
FILES = {PurePath(name).name for name in NAMED if name.endswith(".py")}
MODULES = [
    path.relative_to(ROOT)
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
    if not path.name.startswith("__")
]


@pytest.mark.parametrize("package", PACKAGES)
def test_every_module_has_its_place_in_the_tree(package: str) -> None:
    missing = [
        str(path)
        for path in MODULES
        if path.parts[0] == package and path.name not in FILES and not FOLDERS & set(path.parts[1:-1])
    ]
    assert not missing, f"docs/architecture.md names neither them nor their folder: {missing}"


@pytest.mark.parametrize("name", sorted(NAMED))
def test_every_module_of_the_tree_exists(name: str) -> None:
    """Checks only that a module or folder of this name exists, not that it is in the folder of the tree."""
    found = (path for package in PACKAGES for path in ROOT.glob(f"{package}/**/{name.rstrip('/')}"))
    assert name.rstrip("/") in PACKAGES or next(found, None), f"docs/architecture.md names {name}"

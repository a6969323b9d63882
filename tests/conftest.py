"""Settings of all tests."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from examples import ALL

if TYPE_CHECKING:
    from flying_vines.identification.case import Case

# No deadline, because machines are shared and sometimes slow.
settings.register_profile("all", deadline=None, print_blob=True, max_examples=ALL)
settings.register_profile("quick", settings.get_profile("all"), max_examples=ALL // 3)


def pytest_configure(config: pytest.Config) -> None:
    settings.load_profile("quick" if config.option.markexpr == "not long" else "all")


def pytest_collection_finish() -> None:
    # Imported modules and thousands of tests live until the end: garbage collection need not look at them.
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def short_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case that nobody changes: one short run of a rig whose control volume is larger than nominal."""
    from hidden_truth import draw, write

    folder = tmp_path_factory.mktemp("short") / "workshop"
    write(folder, draw("short", 1))
    return folder


@pytest.fixture(scope="session")
def short_case(short_folder: Path) -> Case:
    from flying_vines.identification.case import read_case

    return read_case(short_folder)

"""Settings that a person changes with our tools are known to the service, if it knew those before."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path

import pytest
from real_time import real_time

from firmware_link.settings import digest
from flying_vines.config import config
from flying_vines.config.address import SerialAddress
from flying_vines.physics.plant.effects import Effects
from flying_vines.service.link_settings import exchange_settings
from flying_vines.service.persistent_state import PersistentState
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar

pytestmark = real_time


async def changed(changes: Mapping[str, float], state: PersistentState) -> int:
    """The digest of the settings of a new board after these changes."""
    with PtyPhlosar(SimulatedPhlosar(effects=Effects())) as port:
        living = asyncio.create_task(port.run())
        try:
            return digest(await exchange_settings(SerialAddress(port.path), changes, asyncio.Event(), state))
        finally:
            living.cancel()
            await asyncio.wait([living])


@pytest.fixture
def state(tmp_path: Path) -> PersistentState:
    return PersistentState.of(tmp_path / "vine.toml", config.default())


async def test_changes_of_known_settings_are_known(state: PersistentState) -> None:
    before = await changed({}, state)
    assert state.read_board_settings() is None
    state.store_board_settings(before)
    after = await changed({"cv_limit_kPa": 25.3}, state)
    assert after != before
    assert state.read_board_settings() == after


@pytest.mark.parametrize("known", [None, 0x1234])
async def test_a_change_of_unknown_settings_confirms_nothing(
    state: PersistentState, known: int | None
) -> None:
    """The person may have changed one value of a board that has lost all others."""
    if known is not None:
        state.store_board_settings(known)
    await changed({"cv_limit_kPa": 25.3}, state)
    assert state.read_board_settings() == known

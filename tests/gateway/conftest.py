"""A running broker, and a subscriber of all its topics."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from .mqtt.brokers import Broker, Onlooker, onlooker, running


@pytest.fixture
async def broker(tmp_path: Path) -> AsyncIterator[Broker]:
    async with running(Broker(tmp_path)) as broker:
        yield broker


@pytest.fixture
async def people(broker: Broker) -> AsyncIterator[Onlooker]:
    async with onlooker(broker) as people:
        yield people

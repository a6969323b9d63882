"""A task that ends is started again, and people are told once."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest
from waiting import until

from flying_vines.gateway import supervisor
from flying_vines.gateway.supervisor import supervise

WHYS = [
    (ValueError("nonsense"), "ValueError: nonsense"),
    (OSError("no port"), "no port"),
    (OSError(28, "No space left on device"), "No space left on device"),
    (ExceptionGroup("several", [ExceptionGroup("more", [KeyError("x")])]), "KeyError: 'x'"),
]


class Part:
    """Fails while it has a reason."""

    def __init__(self, why: Exception | str) -> None:
        self.why: Exception | str | None = why
        self.starts = 0
        self.ended = False
        self.reports: list[str] = []

    async def run(self) -> str:
        self.starts += 1
        if isinstance(self.why, Exception):
            raise self.why
        if self.why is not None:
            return self.why
        try:
            await asyncio.sleep(3600.0)
        finally:
            self.ended = True
        raise AssertionError("a test is shorter")

    @contextlib.asynccontextmanager
    async def kept(self) -> AsyncIterator[None]:
        keeping = asyncio.create_task(supervise("page", self.run, self.reports.append))
        try:
            yield
        finally:
            keeping.cancel()
            await asyncio.gather(keeping, return_exceptions=True)


@pytest.fixture(autouse=True)
def in_a_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor, "FIRST_WAIT_S", 0.001)
    monkeypatch.setattr(supervisor, "MAX_WAIT_S", 0.004)
    monkeypatch.setattr(supervisor, "STABLE_S", 0.02)


@pytest.mark.parametrize("error, why", [*WHYS, ("it hung", "it hung")])
async def test_many_failures_in_a_row_are_reported_once_and_so_is_their_end(
    error: Exception | str, why: str
) -> None:
    part = Part(error)
    async with part.kept():
        await until(lambda: part.starts > 5, "it is tried again and again")
        assert part.reports == [f"page stopped ({why}), starting again"]
        part.why = None
        await until(lambda: len(part.reports) == 2, "it is well")
        assert part.reports[1] == "page running again"
    assert part.ended


async def test_one_that_never_failed_is_not_reported() -> None:
    part = Part("")
    part.why = None
    async with part.kept():
        await asyncio.sleep(0.05)
    assert (part.starts, part.reports, part.ended) == (1, [], True)


async def test_the_wait_grows_and_stays_short(monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float] = []

    async def sleep(seconds: float) -> None:
        waited.append(seconds)
        if len(waited) == 6:
            raise asyncio.CancelledError

    monkeypatch.undo()
    monkeypatch.setattr(asyncio, "sleep", sleep)
    with pytest.raises(asyncio.CancelledError):
        await supervise("page", Part("it hung").run, lambda text: None)
    assert waited == [0.2, 0.4, 0.8, 1.5, 1.5, 1.5]

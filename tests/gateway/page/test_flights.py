"""The flights of the log folder over real sockets: listed and downloaded, and no other file."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from page_bench import TOKEN, Bench, client, served
from real_time import real_time
from yarl import URL

from flying_vines.gateway import page_token

pytestmark = real_time
FLIGHT = "2026-11-23_10-20-30"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two flights, a secret beside them, one inside, and links to both."""
    flights = tmp_path / "flights"
    for name in (FLIGHT, f"{FLIGHT}_2", "notes"):
        (flights / name).mkdir(parents=True)
        (flights / name / "flight.mcap").write_bytes(name.encode())
    (tmp_path / "secret").write_text("secret")
    (flights / FLIGHT / "profile.toml").write_text("secret")
    (flights / FLIGHT / "flight.tlog").symlink_to(tmp_path / "secret")
    (tmp_path / "flight.mcap").write_text("secret")
    (flights / "2026-11-23_10-20-31").symlink_to(tmp_path)
    return flights


@pytest.fixture
async def bench(folder: Path) -> AsyncIterator[Bench]:
    async with served(flights=str(folder)) as bench:
        yield bench


async def test_flights_are_listed_newest_first_and_downloaded(bench: Bench) -> None:
    async with client() as session:
        async with session.get(f"{bench.url}/flights") as response:
            text = await response.text()
        assert response.status == 200
        assert 0 < text.index(f"{FLIGHT}_2/flight.mcap") < text.index(f"{FLIGHT}/flight.mcap")
        assert text.count("<li>") == 2 and "notes" not in text
        async with session.get(f"{bench.url}/flights/{FLIGHT}/flight.mcap") as response:
            assert await response.read() == FLIGHT.encode()
        assert f'filename="{FLIGHT}.mcap"' in response.headers["Content-Disposition"]


@pytest.mark.parametrize(
    "path",
    [
        f"{FLIGHT}/profile.toml",
        f"{FLIGHT}/flight.tlog",
        f"{FLIGHT}/../../secret",
        f"{FLIGHT}/%2e%2e/%2e%2e/secret",
        f"{FLIGHT}%2f..%2f..%2fsecret",
        "../secret",
        "../flight.mcap",
        "%2e%2e/flight.mcap",
        "2026-11-23_10-20-31/flight.mcap",
        "notes/flight.mcap",
        f"{FLIGHT}/flight.mcap/x",
        f"{FLIGHT}/flight.mcap%00",
        "",
    ],
)
async def test_no_other_file_can_be_read(bench: Bench, path: str) -> None:
    async with client() as session:
        address = URL(f"{bench.url}/flights/{path}", encoded=True)
        async with session.get(address) as response:
            assert response.status == 404
            assert "secret" not in await response.text()


async def test_a_viewer_gets_no_flight(folder: Path) -> None:
    statuses = {"": 401, page_token.watching(TOKEN): 403, TOKEN: 200}
    async with served("0.0.0.0", str(folder)) as bench:
        for token, status in statuses.items():
            async with client(Authorization=f"Bearer {token}") as session:
                for path in ("flights", f"flights/{FLIGHT}/flight.mcap"):
                    async with session.get(f"{bench.url}/{path}") as response:
                        assert response.status == status


async def test_a_service_without_a_log_lists_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It does not read its working directory instead."""
    monkeypatch.chdir(folder)
    async with served() as bench, client() as session:
        for path in ("flights", f"flights/{FLIGHT}/flight.mcap"):
            async with session.get(f"{bench.url}/{path}") as response:
                assert response.status == 404

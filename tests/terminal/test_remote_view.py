"""`flying-vines watch` as a process, on a pipe and on a terminal, with a page of the test."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import pty
import signal
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from command_line import run
from page_bench import TOKEN, Bench, served, snapshot
from ports import free_port
from real_time import real_time
from waiting import MAX_WAIT_S, until

from flying_vines.core.events import Decision
from flying_vines.vehicle.notice import Notice, Severity

pytestmark = real_time


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    async with served() as bench:
        yield bench


async def watch(*arguments: str, status: int) -> tuple[str, str]:
    """Run it to its end. Returns the output."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-m", "flying_vines", "watch", *arguments),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    async with asyncio.timeout(MAX_WAIT_S):
        out, err = await process.communicate()
    assert process.returncode == status, err.decode()
    return out.decode(), err.decode()


@contextlib.asynccontextmanager
async def showing(bench: Bench) -> AsyncIterator[None]:
    """Snapshots, as the service sends them."""

    async def show() -> None:
        while True:
            bench.show(snapshot(asyncio.get_running_loop().time(), doing="bend-half", cv_kPa=11.3))
            await asyncio.sleep(0.05)

    task = asyncio.create_task(show())
    yield
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_on_a_pipe_an_event_is_a_line(bench: Bench) -> None:
    bench.happen(Notice(5.0, Severity.WARNING, "Vine: reservoir low"))
    bench.happen(Decision(6.0, "page", {}, "bend-half", "refused", "not armed", 0.0))
    out, err = await watch("--url", bench.url, "--seconds", "0.8", status=0)
    assert "   0.00  Vine: reservoir low" in out
    assert "   1.00  page → bend-half: refused (not armed)" in out
    assert "link: open" in out
    assert not err


async def test_as_json_it_prints_all_messages_of_the_page(bench: Bench) -> None:
    async with showing(bench):
        out, _ = await watch("--url", bench.url, "--seconds", "0.8", "--json", status=0)
    kinds = [json.loads(line)["kind"] for line in out.splitlines()]
    assert kinds[0] == "hello"
    assert kinds.count("snapshot") > 5


@pytest.mark.parametrize(
    "arguments, said",
    [
        (("--url", "ftp://drone"), "give http://HOST:PORT"),
        (("--url", "localhost:99999999"), "--url localhost:99999999"),
        (("--token-file", "/nowhere/token"), "/nowhere/token"),
        (("--seconds", "0"), "--seconds must be above 0"),
    ],
)
def test_bad_input_is_a_line_and_status_2(
    arguments: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = run(capsys, "watch", *arguments)
    assert status == 2
    assert said in err
    assert len(err.splitlines()) == 1
    assert not out


def test_no_vehicle_is_status_1(capsys: pytest.CaptureFixture[str]) -> None:
    port = free_port()
    status, out, _ = run(capsys, "watch", "--url", f"http://127.0.0.1:{port}", "--seconds", "0.3")
    assert status == 1
    assert f"link: 127.0.0.1:{port}: Connection refused" in out


@pytest.mark.long
async def test_a_page_on_the_network_needs_its_token(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text(TOKEN)
    file.chmod(0o600)
    async with served("0.0.0.0") as bench:
        _, err = await watch("--url", bench.url, status=2)
        assert "--token-file FILE" in err
        out, _ = await watch("--url", bench.url, "--token-file", str(file), "--seconds", "0.5", status=0)
        assert "link: open" in out
        out, _ = await watch("--url", f"{bench.url}/?token={TOKEN}", "--seconds", "0.5", status=0)
        assert "link: open" in out


class Terminal:
    """A process on a pseudo-terminal, and its output."""

    def __init__(self, process: asyncio.subprocess.Process, number: int) -> None:
        self.process = process
        self.screen = ""
        self._number = number
        asyncio.get_running_loop().add_reader(number, self._read)

    def _read(self) -> None:
        try:
            self.screen += os.read(self._number, 65536).decode(errors="replace")
        except OSError:
            asyncio.get_running_loop().remove_reader(self._number)

    def type(self, keys: str) -> None:
        os.write(self._number, keys.encode())

    async def shows(self, text: str) -> None:
        """Wait until it shows this from now on."""
        self.screen = ""
        await until(lambda: text in self.screen, text)


@contextlib.asynccontextmanager
async def on_terminal(bench: Bench, term: str = "xterm-256color") -> AsyncIterator[Terminal]:
    ours, theirs = pty.openpty()
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-m", "flying_vines", "watch", "--url", bench.url),
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env={**os.environ, "TERM": term, "COLUMNS": "48", "LINES": "30"},
    )
    os.close(theirs)
    terminal = Terminal(process, ours)
    try:
        yield terminal
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        asyncio.get_running_loop().remove_reader(ours)
        os.close(ours)


async def test_on_a_terminal_it_is_live_and_v_twice_vents(bench: Bench) -> None:
    async with showing(bench), on_terminal(bench) as terminal:
        await terminal.shows("bend-half")
        await terminal.shows("11.3 kPa")
        terminal.type("v")
        await terminal.shows("press v again to vent")
        assert not bench.asked
        bench.answers = False
        terminal.type("v")
        await terminal.shows("VENT not confirmed")
        await until(lambda: len(bench.asked) >= 2, "both are asked for")
        bench.answers = True
        await terminal.shows("VENT confirmed after")
        assert {ask.command for ask in bench.asked} == {"vent"}
        terminal.type("q")
        async with asyncio.timeout(MAX_WAIT_S):
            assert await terminal.process.wait() == 0


async def test_a_terminal_that_cannot_be_redrawn_gets_lines(bench: Bench) -> None:
    async with on_terminal(bench, "dumb") as terminal, showing(bench):
        await terminal.shows("link: open")
    assert "\x1b" not in terminal.screen


@pytest.mark.long
async def test_a_link_that_is_lost_is_reported_and_comes_back(bench: Bench) -> None:
    async with on_terminal(bench) as terminal:
        async with showing(bench):
            await terminal.shows("bend-half")
        await terminal.shows("These data are 3 s old")
        await terminal.shows("page link: the service is silent")
        async with showing(bench):
            await terminal.shows("link: open")
        terminal.process.send_signal(signal.SIGINT)
        async with asyncio.timeout(MAX_WAIT_S):
            assert await terminal.process.wait() == 130
    assert "Traceback" not in terminal.screen

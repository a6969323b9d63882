"""MAVProxy as a process with typed input."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.util import find_spec
from pathlib import Path

from waiting import MAX_WAIT_S

HOW_TO_INSTALL = "MAVProxy is not installed: pip install 'flying-vines[dev]'"


def installed() -> bool:
    return find_spec("MAVProxy") is not None and find_spec("future") is not None


class MavProxy:
    """One running MAVProxy. `text` is everything that it has printed."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.text = ""
        self._process = process
        self._read_to = 0

    async def read(self) -> None:
        """Read its output until it ends."""
        assert self._process.stdout
        while printed := await self._process.stdout.read(4096):
            self.text += printed.decode(errors="replace")

    def type(self, line: str) -> None:
        """Type a command. `sees` ignores earlier output."""
        assert self._process.stdin
        self._read_to = len(self.text)
        self._process.stdin.write(f"{line}\n".encode())

    @property
    def answer(self) -> str:
        """The output since the last command."""
        return self.text[self._read_to :]

    def printed(self, pattern: str) -> re.Match[str] | None:
        """The first match in the output since the last command."""
        return re.compile(pattern).search(self.text, self._read_to)

    async def sees(self, pattern: str, again: str = "") -> re.Match[str]:
        """Wait for matching output; with `again`, type this every second meanwhile."""
        deadline = asyncio.get_running_loop().time() + MAX_WAIT_S
        typed_at = -1.0
        while (match := self.printed(pattern)) is None:
            now = asyncio.get_running_loop().time()
            assert now < deadline, f"MAVProxy never printed {pattern!r}:\n{self.answer}"
            assert self._process.returncode is None, f"MAVProxy ended:\n{self.text}"
            if again and now - typed_at > 1.0:
                typed_at = now
                self.type(again)
            await asyncio.sleep(0.02)
        return match

    async def answers(self, line: str, pattern: str, again: str = "") -> re.Match[str]:
        """Type a line and wait for matching output."""
        self.type(line)
        return await self.sees(pattern, again)


@asynccontextmanager
async def mavproxy(port: int, folder: Path) -> AsyncIterator[MavProxy]:
    """Run MAVProxy, which listens on a UDP port of this machine and writes its files to `folder`."""
    script = Path(sys.executable).with_name("mavproxy.py")
    program = str(script) if script.exists() else shutil.which("mavproxy.py")
    assert program, HOW_TO_INSTALL
    environment = {**os.environ, "HOME": str(folder), "PYTHONUNBUFFERED": "1", "TERM": "dumb"}
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        program,
        f"--master=udp:127.0.0.1:{port}",
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        cwd=folder,
        env=environment,
    )
    proxy = MavProxy(process)
    reading = asyncio.create_task(proxy.read())
    try:
        yield proxy
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()
        await reading

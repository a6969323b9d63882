"""A pseudo-terminal that can be unplugged, behind a link of fixed name."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tty
from pathlib import Path

from waiting import MAX_WAIT_S


class Terminal:
    """The device's end of a pseudo-terminal."""

    def __init__(self, link: Path) -> None:
        self.device, self._host = os.openpty()
        tty.setraw(self._host)
        os.set_blocking(self.device, False)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(self._host))
        self._link = link

    def pull_out(self) -> None:
        self.unplug()
        self._link.unlink()

    def unplug(self) -> None:
        for descriptor in (self.device, self._host):
            with contextlib.suppress(OSError):
                os.close(descriptor)

    async def read(self, count: int) -> bytes:
        data = b""
        async with asyncio.timeout(MAX_WAIT_S):
            while len(data) < count:
                with contextlib.suppress(BlockingIOError):
                    data += os.read(self.device, 65536)
                await asyncio.sleep(0)
        return data

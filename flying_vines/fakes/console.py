"""A fake autopilot, flown by typing."""

from __future__ import annotations

import asyncio
import os
import stat
import sys
from collections.abc import Callable

from flying_vines.fakes.autopilot import Autopilot

HELP = """\
arm · disarm · takeoff METRES · land · mission · mode NAME · rc CHANNEL MICROSECONDS
lose_rc · return_rc · mute SECONDS · reboot"""

COMMANDS: dict[str, tuple[int, Callable[..., None]]] = {
    "arm": (0, lambda a: a.arm()),
    "disarm": (0, lambda a: a.disarm()),
    "takeoff": (1, lambda a, height: a.takeoff(float(height))),
    "land": (0, lambda a: a.land()),
    "mission": (0, lambda a: a.start_mission()),
    "mode": (1, lambda a, name: a.set_mode(name.upper())),
    "rc": (2, lambda a, channel, pulse: a.set_rc(int(channel), int(pulse))),
    "lose_rc": (0, lambda a: a.lose_rc()),
    "return_rc": (0, lambda a: a.return_rc()),
    "mute": (1, lambda a, seconds: a.mute(float(seconds))),
    "reboot": (0, lambda a: a.reboot()),
}


def obey(autopilot: Autopilot, line: str) -> str:
    """Do what a line says; what to tell the person who typed it, or nothing."""
    words = line.split()
    if not words:
        return ""
    name, arguments = words[0], words[1:]
    if name not in COMMANDS:
        return HELP
    count, act = COMMANDS[name]
    if len(arguments) != count:
        return HELP
    try:
        act(autopilot, *arguments)
    except ValueError as error:
        return f"{name}: {error}"
    return ""


async def type_to(autopilot: Autopilot) -> None:
    """Obey standard input, line by line, until it ends; where nobody can type there (a service), at once."""
    kind = os.fstat(sys.stdin.fileno()).st_mode
    if not (sys.stdin.isatty() or stat.S_ISFIFO(kind) or stat.S_ISSOCK(kind)):
        return
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := await reader.readline():
        answer = obey(autopilot, line.decode(errors="replace"))
        if answer:
            print(answer, flush=True)

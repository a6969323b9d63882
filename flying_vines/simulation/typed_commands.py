"""Typed commands for the simulated autopilot, and typed failures for the simulated phloSAR."""

from __future__ import annotations

import asyncio
import os
import stat
import sys
from collections.abc import Callable
from itertools import groupby

from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.mishaps import PLACES, Mishaps, kind_from, words_for
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar

HELP = """\
arm · disarm · takeoff METRES · land · mission · mode NAME · rc CHANNEL MICROSECONDS
lose_rc · return_rc · mute SECONDS · reboot"""

_COMMANDS: dict[str, tuple[Callable[..., None], *tuple[Callable[[str], object], ...]]] = {
    "arm": (FakeAutopilot.arm,),
    "disarm": (FakeAutopilot.disarm,),
    "takeoff": (FakeAutopilot.takeoff, float),
    "land": (FakeAutopilot.land,),
    "mission": (FakeAutopilot.start_mission,),
    "mode": (FakeAutopilot.set_mode, str.upper),
    "rc": (FakeAutopilot.set_rc, int, int),
    "lose_rc": (FakeAutopilot.lose_rc,),
    "return_rc": (FakeAutopilot.return_rc,),
    "mute": (FakeAutopilot.mute, float),
    "reboot": (FakeAutopilot.reboot,),
}
"""Stimuli, and what reads their arguments."""


def obey(autopilot: FakeAutopilot, line: str) -> str:
    """Carry out a typed line. Returns a text for the user, or an empty text."""
    words = line.split()
    if not words:
        return ""
    name, *arguments = words
    act, *readers = _COMMANDS.get(name, (None,))
    if act is None or len(arguments) != len(readers):
        return HELP
    try:
        act(autopilot, *(read(word) for read, word in zip(readers, arguments, strict=True)))
    except ValueError as error:
        return f"{name}: {error}"
    return ""


MISHAPS = "\n".join(
    [
        f"{', '.join(places)}:\n  {' · '.join(words)}"
        for words, places in groupby(PLACES, lambda place: [words_for(place, word) for word in PLACES[place]])
    ]
    + ["any place:\n  well (repairs this place)\nwell (repairs everything)"]
)


def inject_typed(phlosar: SimulatedPhlosar, line: str) -> str:
    """Apply the failure in a typed line. Returns a text for the user, or an empty text."""
    words = line.split()
    if not words:
        return ""
    if words == ["well"]:
        phlosar.mishaps = Mishaps()
        return ""
    place, kind = words[0], words[1:]
    if place not in PLACES:
        return MISHAPS
    try:
        phlosar.inject(place, None if kind == ["well"] else kind_from(place, kind))
    except ValueError as error:
        return str(error)
    return ""


async def type_to(obeyed: Callable[[str], str]) -> None:
    """Pass typed lines to `obeyed` until the input ends.

    Returns at once if the standard input is not a terminal, pipe or socket, as in a service.
    """
    kind = os.fstat(sys.stdin.fileno()).st_mode
    if not (sys.stdin.isatty() or stat.S_ISFIFO(kind) or stat.S_ISSOCK(kind)):
        return
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := await reader.readline():
        answer = obeyed(line.decode(errors="replace"))
        if answer:
            print(answer, flush=True)

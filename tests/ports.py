"""Free ports for tests that run at the same time."""

from __future__ import annotations

import itertools
import os
import random
import socket

# Below the ports that the system gives out itself; each process begins at another port.
_FIRST, _LAST = 10_000, 30_000
_offered = itertools.count(random.Random(os.getpid()).randrange(_LAST - _FIRST))


def free_port() -> int:
    """A port that is free for TCP and UDP at the moment; each call returns another one."""
    for offered in _offered:
        port = _FIRST + offered % (_LAST - _FIRST)
        try:
            for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
                with socket.socket(socket.AF_INET, kind) as probe:
                    probe.bind(("", port))
        except OSError:
            continue
        return port
    raise AssertionError("it counts for ever")

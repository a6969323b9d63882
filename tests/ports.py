"""Free ports for tests that run at the same time."""

from __future__ import annotations

import itertools
import os
import random
import socket

# Below those that a system gives to whoever asks for any; each process begins elsewhere.
_FIRST, _LAST = 10_000, 30_000
_offered = itertools.count(random.Random(os.getpid()).randrange(_LAST - _FIRST))


def free_port() -> int:
    """For TCP and UDP, when it was looked for; the next call's is another."""
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

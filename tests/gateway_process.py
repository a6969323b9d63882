"""Finds the gateway's process of a service."""

from __future__ import annotations

from pathlib import Path


def gateway_of(pid: int) -> int:
    """The id of the only child process that was started as a gateway. Raises ValueError if there is none, or
    several."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    (gateway,) = (
        int(child)
        for child in children
        if b"flying_vines.gateway" in Path(f"/proc/{child}/cmdline").read_bytes()
    )
    return gateway

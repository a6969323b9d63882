"""Writes a vehicle's mission to a file for ground stations."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from flying_vines.vehicle.autopilots import AUTOPILOTS
from missions.link import vehicle
from missions.mission import MissionError
from missions.plan_file import write_plan
from missions.waypoints import write_waypoints


async def download(path: Path, link: str, console: Console) -> int:
    """Write the vehicle's mission to `path`, a .plan or .waypoints file.

    Raises:
        MissionError: there is no mission, or the file cannot be written.
        VehicleLinkError: no vehicle, or it does not answer.
    """
    if path.suffix.casefold() not in (".plan", ".waypoints"):
        raise MissionError(f"{path}: the file must be a .plan or .waypoints")
    async with vehicle(link) as peer:
        items = await peer.download()
    if not items:
        raise MissionError(f"{AUTOPILOTS[peer.kind].title} has no mission")
    try:
        if path.suffix.casefold() == ".plan":
            write_plan(path, items, peer.kind)
        else:
            write_waypoints(path, items)
    except OSError as error:
        raise MissionError(f"{path}: cannot be written: {error.strerror}") from None
    except ValueError as error:
        raise MissionError(f"{path}: cannot be written: {error}; use a .waypoints file") from None
    console.print(f"Written  {path}: {len(items)} items of {AUTOPILOTS[peer.kind].title}", soft_wrap=True)
    return 0

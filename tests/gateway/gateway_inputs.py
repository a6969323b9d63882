"""Inputs of a gateway for tests: the first message, snapshots and events as from the service."""

from __future__ import annotations

from typing import Any

import msgspec

from flying_vines.config import config
from flying_vines.config.config import Config
from flying_vines.core.events import Decision
from flying_vines.core.snapshot import Snapshot
from flying_vines.gateway.messages import GatewayStart, Happened, SnapshotMessage, raw
from flying_vines.supply import CyclesLeft
from flying_vines.vehicle.notice import Notice, Severity

CYCLES = CyclesLeft(31.2, 27.9, 35.0, 12.0, 18.4, 102.0, 15.0, 1.4, 80.0, 65.0, 110.0)


def start(**mqtt: Any) -> GatewayStart:
    """The service's first message, with the built-in configuration and without a page."""
    return GatewayStart(configured(**mqtt), "1.2.3")


def configured(**mqtt: Any) -> Config:
    built_in = config.default()
    return msgspec.structs.replace(
        built_in, page=config.PageConfig(port=0), mqtt=msgspec.structs.replace(built_in.mqtt, **mqtt)
    )


def snapshot(t: float, **known: Any) -> Snapshot:
    nan = float("nan")
    fields: dict[str, Any] = {
        "t": t,
        "vehicle": "ArduPilot 1",
        "mode": "AUTO",
        "armed": True,
        "altitude_m": 9.8,
        "rc": "good",
        "switch_position": 2,
        "actuator": "phloSAR",
        "firmware": "ready",
        "round_trip_s": 0.0012,
        "telemetry_gaps": 0,
        "reservoir_kPa": 612.5,
        "cv_kPa": 20.6,
        "command_kPa": 20.7,
        "bend_deg": 59.7,
        "evp_opening": nan,
        "dvp_opening": nan,
        "solenoid": None,
        "cycles": CYCLES,
        "doing": "bend-full",
    }
    return Snapshot(**(fields | known))


def seen(t: float, **known: Any) -> SnapshotMessage:
    return SnapshotMessage(raw(snapshot(t, **known)))


def decision(t: float, safety: Any = "accepted", reason: str = "") -> Decision:
    return Decision(t, "switch", {"position": 2}, "bend-full", safety, reason, 20.7)


def notice(t: float, text: str = "Vine: phloSAR is back") -> Notice:
    return Notice(t, Severity.NOTICE, text)


def happened(thing: Decision | Notice) -> Happened:
    """The event as `Gateway.action` makes it."""
    return Happened(type(thing).__name__.lower(), raw(thing))

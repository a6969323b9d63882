"""Requests that do not come over MAVLink: by the page, the broker or a calibration."""

from __future__ import annotations

import math

from flying_vines.config.config import Config
from flying_vines.core.events import Asked
from flying_vines.vehicle.triggers import Trigger, only_deflates
from flying_vines.vine.intent import ACTS_WITHIN_S, COMMAND_OF, ClearLatchedFaults

PAGE_COMMANDS = ("clear_faults", "arm", "start_bench")
"""The page may send these commands without bench mode. Any command that only deflates the vine is always
allowed. While the vehicle is armed, `start_bench` is refused."""


def trigger_of(asked: Asked, config: Config, armed: bool, bench: bool) -> Trigger:
    """The trigger for a request. If the request must be refused, `problem` of the trigger is the reason.

    `armed`: the vehicle is armed. `bench`: bench mode is on.
    """
    t, by, intent = asked.t, asked.by, asked.intent
    problem = "" if only_deflates(config, intent) else _problem(asked, config, armed, bench)
    seen_at = asked.seen_at
    if by == "calibration":
        seen_at = t
    elif seen_at is None or seen_at > t:
        # No `seen_at`, or one from before a restart of this computer: the person saw no fault of this run.
        seen_at = -math.inf
    if isinstance(intent, ClearLatchedFaults) and seen_at == -math.inf:
        problem = problem or "the request does not say which state the person saw"
    return Trigger(t, by, {}, intent, problem, by_person=not problem, seen_at=seen_at)


def _problem(asked: Asked, config: Config, armed: bool, bench: bool) -> str:
    age_s = 0.0 if asked.made_at is None else asked.t - asked.made_at
    if age_s > ACTS_WITHIN_S:
        return f"too late: requested {age_s:.1f} s ago"
    command = COMMAND_OF[type(asked.intent)]
    if asked.by == "broker" and command not in config.mqtt.commands:
        return f"mqtt.commands does not list {command}"
    if asked.by == "page" and command not in PAGE_COMMANDS:
        if armed:
            return "the page cannot bend the vine while the vehicle is armed"
        if not (bench or config.interlocks.bench_mode):
            return "the page can bend the vine only in bench mode"
    return ""

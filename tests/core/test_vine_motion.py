"""The present motion alone: what it commands, when it is over, and whether the vine is vented."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from firmware_link import host as fw
from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.config import config
from flying_vines.core.vine_motion import STRAIGHTENS_WITHIN_S, VineMotion
from flying_vines.vine.intent import SetPressure


class Board(fw.HostSession):
    """A session whose telemetry reads this pressure."""

    def __init__(self, cv_kPa: float) -> None:
        super().__init__()
        self.telemetry: Any = SimpleNamespace(cv_kPa=cv_kPa)


def straightening(cv_kPa: float) -> VineMotion:
    vine = VineMotion(config.default(), Board(20.0), 0.02)
    vine.motion = vine.plan(0.0, SetPressure(0.0))
    vine._firmware = Board(cv_kPa)
    return vine


@pytest.mark.parametrize(("cv_kPa", "motion", "vented"), [(0.2, 0, 1), (0.2, 1, 0), (5.0, 0, 0), (5.0, 1, 0)])
def test_a_vine_is_vented_without_a_motion_and_without_pressure(
    cv_kPa: float, motion: int, vented: int
) -> None:
    vine = straightening(cv_kPa)
    if not motion:
        vine.motion = None
    assert vine.vented == bool(vented)


def test_a_motion_to_ambient_pressure_ends_when_the_vine_is_there_or_some_time_after_its_end() -> None:
    over_s = straightening(0.0).motion.duration_s + 0.01  # type: ignore[union-attr]
    assert straightening(0.2).ended(over_s - 0.1) is None
    assert straightening(0.2).ended(over_s) is not None
    assert straightening(5.0).ended(over_s + STRAIGHTENS_WITHIN_S - 0.1) is None
    stuck = straightening(5.0)
    assert stuck.ended(over_s + STRAIGHTENS_WITHIN_S) is not None
    assert stuck.motion is None


def test_a_bend_does_not_end_by_itself() -> None:
    vine = straightening(0.2)
    vine.motion = vine.plan(0.0, SetPressure(10.0))
    assert vine.ended(1e6) is None


def test_the_setpoint_of_a_board_that_vents_is_not_compared() -> None:
    vine = VineMotion(config.default(), Board(0.0), 0.02)
    vine.motion = vine.plan(0.0, SetPressure(10.0))
    for tick in range(200):
        t = 0.02 * tick
        vine.command(t)
        vine.note(t, t, Telemetry(tick, Mode.VENT, Fault.NONE, 1, 0.0, 0.0, 690.0, 0.0, 0.0, True))
    assert vine.wrong_setpoint_kPa is None
    assert vine.mode_mismatch_s > 0.3

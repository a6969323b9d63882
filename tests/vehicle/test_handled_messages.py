"""The list of handled messages is complete; all others are skipped early."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.core.core import Core
from flying_vines.core.events import Event, Tick, ToVehicle, VehicleMessage
from flying_vines.vehicle.component.parameters import Parameters
from flying_vines.vehicle.component.requests import Requests
from flying_vines.vehicle.mavlink import handled_messages as handled
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mavlink.tlog import TlogReader

NAMES = {number: kind.msgname for number, kind in mavlink.mavlink_map.items()}
ROOM = Path(handled.__file__).parents[1]
RECORDINGS = sorted((Path(__file__).parents[1] / "data" / "recordings").glob("*.tlog"))
QUICK = ("ardupilot_vine_mission", "px4_vine_mission", "rc_switch")
"""`make test` also replays these."""


def test_messages_that_the_code_names_are_handled() -> None:
    looked_for = {
        node.value
        for source in ROOM.rglob("*.py")
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and node.value in NAMES.values()
    }
    assert {"RC_CHANNELS", "STATUSTEXT", "COMMAND_LONG"} < looked_for
    assert looked_for <= handled.ALL


def test_requests_to_us_are_handled() -> None:
    assert {NAMES[number] for number in (*Requests.MESSAGES, *Parameters.MESSAGES)} <= handled.ALL


@pytest.mark.parametrize(
    "path",
    [path if path.stem in QUICK else pytest.param(path, marks=pytest.mark.long) for path in RECORDINGS],
    ids=lambda path: path.stem,
)
def test_other_messages_cause_no_output(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flown(codec: MavlinkCodec) -> list[str]:
        core, ticked, done = Core(config.default()), 0.0, []
        for t, frame in TlogReader(path).frames():
            events: list[Event] = [VehicleMessage(t, message) for message in codec.decode(frame)]
            if t - ticked > 0.02:
                ticked = t
                events.append(Tick(t))
            actions = [action for event in events for action in core.handle(event)]
            done += [str(a.message) if isinstance(a, ToVehicle) else str(a) for a in actions]
        return done

    quick = flown(MavlinkCodec(0, 191, read=handled.NUMBERS))
    monkeypatch.setattr(handled, "ALL", set(NAMES.values()))
    assert quick == flown(MavlinkCodec(0, 191))
    assert len(quick) > 100

"""Texts to the pilot, and the vine, when the link to the autopilot is lost fully or partly."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import msgspec
import pytest

from flying_vines.config import config
from flying_vines.config.config import Config
from flying_vines.core.events import Action, Decision, LinkChanged, VehicleMessage
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot.links import COMPANION
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.state import HEARTBEAT_FRESH_S

from .flights import shown
from .prepared import prepared
from .test_core_late import Queue

LOW, HIGH = 1000, 2000
WAITING = "Vine: waiting for: switch down, then up"
HEARTBEAT, RC_CHANNELS = 0, 65


def bent(conf: Config | None = None, rc: bool = True) -> SimulatedFlight:
    """A flight at 10 m. The switch has bent the vine, or a button in a flight without RC."""
    return prepared(_bent, conf or config.default(), rc)


def _bent(conf: Config, rc: bool) -> SimulatedFlight:
    autopilot = FakeAutopilot("ardupilot", rc_failsafe_mode=None)
    flight = SimulatedFlight(conf, autopilot)
    autopilot.set_rc(9, LOW)
    flight.run(2.0)
    autopilot.takeoff(10.0)
    flight.run(8.0)
    if rc:
        autopilot.set_rc(9, HIGH)
        flight.run(10.0)
        assert flight.phlosar.cv_kPa > 15.0
    return flight


def holding(**losses: object) -> Config:
    conf = config.default()
    return msgspec.structs.replace(conf, losses=msgspec.structs.replace(conf.losses, **losses))


def lives(flight: SimulatedFlight, for_s: float) -> list[Action]:
    return flight.run(flight.world.now + for_s)


def texts_of(actions: Sequence[Action]) -> list[str]:
    return [action.text for action in actions if isinstance(action, Notice)]


def lost(actions: Sequence[Action]) -> list[str]:
    return [str(action.what.get("loss")) for action in actions if isinstance(action, Decision)]


def without(flight: SimulatedFlight, *message_ids: int) -> None:
    """Lose these messages, and no others."""
    flight.from_autopilot = lambda frame: (
        b"" if int.from_bytes(frame[7:10], "little") in message_ids else frame
    )


@pytest.mark.parametrize("for_s", [1.8, 4.0, pytest.param(20.0, marks=pytest.mark.long)])
def test_a_silent_link_is_reported_once_and_once_when_it_is_back(for_s: float) -> None:
    flight = bent()
    flight.autopilot.mute(for_s)
    actions = lives(flight, for_s)
    assert texts_of(actions) == ["Vine: vehicle link silent, vented"]
    assert lost(actions)[0] == "rc"
    assert ("autopilot" in lost(actions)) == (for_s > 3.5), (
        "the loss of the autopilot is logged without a text"
    )
    assert flight.phlosar.cv_kPa < 1.0
    assert texts_of(lives(flight, 10.0)) == ["Vine: vehicle link is back", WAITING]


class Stall:
    """A wire that stops for some time and then delivers its queue, `at_once` frames for each new one."""

    def __init__(self, flight: SimulatedFlight, for_s: float, at_once: int) -> None:
        self._flight, self._until, self._at_once = flight, flight.world.now + for_s, at_once
        self._queued: deque[bytes] = deque()

    def __call__(self, frame: bytes) -> bytes:
        self._queued.append(frame)
        if self._flight.world.now < self._until:
            return b""
        return b"".join(self._queued.popleft() for _ in range(min(len(self._queued), self._at_once)))


LATE = "Vine: vehicle link more than 1 s late, vented"


@pytest.mark.parametrize(
    ("for_s", "at_once", "late"),
    [(1.5, 10, []), (3.0, 10, []), (3.0, 2, [LATE]), pytest.param(10.0, 4, [LATE], marks=pytest.mark.long)],
)
def test_a_stall_is_one_loss_and_the_link_is_back_when_it_is_in_time(
    for_s: float, at_once: int, late: list[str]
) -> None:
    flight = bent()
    flight.from_autopilot = Stall(flight, for_s, at_once)
    actions = lives(flight, for_s + 15.0)
    told = [a.text for a in actions if isinstance(a, Notice) and a.severity is not Severity.DEBUG]
    assert told == ["Vine: vehicle link silent, vented", *late, "Vine: vehicle link is back", WAITING]


def test_a_stall_is_one_loss_also_if_its_first_frames_are_read_before_the_loss_is_found() -> None:
    flight = bent()
    t = flight.world.now + 10.0
    queued = b"".join(frame for link, frame in flight.autopilot.advance(t) if link == COMPANION)
    first, *later = [VehicleMessage(t, message) for message in flight._codec.decode(queued, t)]
    actions = flight.feed(first)
    actions += flight.stall(t)
    for message in later:
        actions += flight.feed(message)
    actions += lives(flight, 10.0)
    losses = [text for text in shown(actions) if "vented" in text and "firmware" not in text]
    assert losses == ["Vine: this computer is too busy: late by 10.0 s, vented"]


def test_a_link_is_back_with_the_first_heartbeat() -> None:
    """Any frame proves that the autopilot is alive, but only a heartbeat says if it is armed."""
    flight = bent()
    flight.autopilot.mute(8.0)
    lives(flight, 7.9)
    without(flight, HEARTBEAT)
    assert texts_of(lives(flight, 3.0)) == []
    without(flight)
    assert texts_of(lives(flight, 2.0)) == ["Vine: vehicle link is back", WAITING]


@pytest.mark.long
def test_a_silent_link_is_reported_again_when_hold_changes_to_vent() -> None:
    flight = bent(holding(on_rc_loss="hold", hold_at_most_s=1.5))
    flight.autopilot.mute(20.0)
    texts = texts_of(lives(flight, 20.0))
    assert texts == ["Vine: vehicle link silent, holding", "Vine: vehicle link silent, vented"]


def test_a_closed_link_is_reported_as_closed() -> None:
    flight = bent()
    flight.feed(LinkChanged(flight.world.now, "vehicle", False, "was unplugged"))
    flight.from_autopilot = lambda frame: b""
    assert texts_of(lives(flight, 10.0)) == ["Vine: vehicle link closed, vented"]
    flight.feed(LinkChanged(flight.world.now, "vehicle", True, ""))
    assert texts_of(lives(flight, 2.0)) == []
    flight.from_autopilot = lambda frame: frame
    assert texts_of(lives(flight, 10.0)) == ["Vine: vehicle link is back", WAITING]


def test_a_link_that_is_back_without_rc_is_reported() -> None:
    flight = bent()
    flight.autopilot.mute(5.0)
    lives(flight, 4.9)
    without(flight, RC_CHANNELS)
    assert texts_of(lives(flight, 4.0)) == ["Vine: vehicle link is back, RC lost: no RC_CHANNELS yet"]
    without(flight)
    assert texts_of(lives(flight, 2.0)) == ["Vine: RC is back", WAITING]


def test_missing_rc_is_not_reported_as_a_silent_link() -> None:
    flight = bent()
    without(flight, RC_CHANNELS)
    assert texts_of(lives(flight, 4.0)) == ["Vine: RC lost: no RC_CHANNELS for 1 s, vented"]


def test_a_switch_that_moved_while_the_link_was_silent_bends_nothing() -> None:
    flight = bent()
    flight.autopilot.mute(5.0)
    lives(flight, 2.0)
    flight.autopilot.set_rc(9, LOW)
    lives(flight, 2.0)
    flight.autopilot.set_rc(9, HIGH)
    lives(flight, 6.0)
    assert flight.phlosar.cv_kPa < 1.0


def test_any_frame_of_the_autopilot_proves_that_it_runs() -> None:
    """Without heartbeats for 3.9 s, the autopilot is not lost while other frames arrive."""
    flight = bent()
    without(flight, HEARTBEAT)
    actions = lives(flight, 3.9)
    without(flight)
    assert texts_of(actions) + texts_of(lives(flight, 3.0)) == []
    assert flight.phlosar.cv_kPa > 15.0


def test_without_heartbeats_the_arm_state_is_unknown_and_the_vine_vents() -> None:
    flight = bent()
    began_s = flight.world.now
    without(flight, HEARTBEAT)
    actions = lives(flight, HEARTBEAT_FRESH_S + 1.5)
    assert texts_of(actions) == ["Vine: no HEARTBEAT: arm state unknown, vented"]
    (decision,) = (action for action in actions if isinstance(action, Decision))
    assert HEARTBEAT_FRESH_S - 1.1 < decision.t - began_s < HEARTBEAT_FRESH_S + 0.2
    flight.autopilot.set_rc(9, LOW)
    lives(flight, 1.0)
    flight.autopilot.set_rc(9, HIGH)
    refused = [text for text in texts_of(lives(flight, 1.0)) if "refused" in text]
    assert len(refused) == 1
    assert refused[0].endswith(": no HEARTBEAT: arm state unknown")
    assert flight.phlosar.cv_kPa < 1.0
    without(flight)
    assert texts_of(lives(flight, 2.0)) == ["Vine: autopilot is back", WAITING]


def test_the_state_of_the_radio_is_forgotten_when_the_autopilot_is_silent() -> None:
    """After the silence, another autopilot may answer."""
    flight = bent()
    flight.autopilot.mute(6.0)
    lives(flight, 2.5)
    assert flight.core.snapshot(flight.world.now).rc == "no RC_CHANNELS for 1 s"
    lives(flight, 2.0)
    assert flight.core.snapshot(flight.world.now).rc == "no RC_CHANNELS yet"


def test_a_link_that_is_late_and_then_dead_is_told_as_both_and_so_are_their_ends() -> None:
    flight = bent()
    flight.from_autopilot = Queue(flight, later_s_per_s=0.5, longest_s=3.0)
    texts = shown(lives(flight, 4.0))
    flight.from_autopilot = lambda frame: b""
    texts += shown(lives(flight, 3.0))
    late, silent = "Vine: vehicle link more than 1 s late, vented", "Vine: vehicle link silent, vented"
    assert [text for text in texts if "waiting" not in text] == [late, silent]
    flight.from_autopilot = lambda frame: frame
    assert "Vine: vehicle link is back" in [text.partition(" (")[0] for text in shown(lives(flight, 6.0))]

"""Settings are all read before one is changed, and unknown ones are refused."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from firmware_link.protocol import (
    PROTOCOL_VERSION,
    Codec,
    GetSetting,
    Hello,
    HostMessage,
    Refusal,
    RefusalReason,
    SetSetting,
    Setting,
)
from firmware_link.settings import SettingsTalk
from flying_vines.simulation.phlosar.firmware import Firmware


class Board:
    """A firmware that is asked, with a tenth of a second for each turn."""

    def __init__(self) -> None:
        self.firmware = Firmware()
        self.asked: list[HostMessage] = []
        self._codec, self._answers = Codec(), Codec()
        self._t = 0.0
        self.firmware.step(0, 0.0, 690.0)
        self.firmware.receive(self._codec.encode(Hello(PROTOCOL_VERSION, 1)))

    def talk(self, changes: Mapping[str, float] | None = None, lose_every: int = 0) -> SettingsTalk:
        """Talk until the end. Every `lose_every`th request is lost."""
        talk = SettingsTalk(changes)
        for _ in range(400):
            self._t += 0.1
            for message in talk.due(self._t):
                self.asked.append(message)
                if not lose_every or len(self.asked) % lose_every:
                    self.firmware.receive(self._codec.encode(message))
            for answer in self._answers.decode(self.firmware.take_output()):
                talk.receive(answer)
            if talk.done or talk.problem:
                return talk
        raise AssertionError("it does not end")


def test_all_are_read_in_order() -> None:
    board = Board()
    talk = board.talk()
    assert talk.done
    count = talk.settings[0].count
    assert [setting.id for setting in talk.settings] == list(range(count))
    assert board.asked == [GetSetting(number) for number in range(count)]
    assert talk.settings[0].name == "cv_limit_kPa"
    assert talk.settings[0].value == 30.0


def test_a_lost_request_is_repeated() -> None:
    whole, holey = Board().talk(), Board().talk({"cv_limit_kPa": 25.0}, lose_every=3)
    assert holey.done
    assert holey.settings[0].value == 25.0
    assert holey.settings[1:] == whole.settings[1:]


def test_changes_are_made_and_kept() -> None:
    board = Board()
    talk = board.talk({"cv_limit_kPa": 25.3, "dead_man_ms": 200.0})
    assert talk.done
    assert board.firmware.settings["dead_man_ms"] == 200
    assert board.firmware.settings["cv_limit_kPa"] == pytest.approx(25.3)
    board.firmware.reset()
    assert board.firmware.settings["dead_man_ms"] == 200


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"cv_limit": 25.0}, "no setting cv_limit; did you mean cv_limit_kPa?"),
        ({"colour": 1.0}, "no setting colour: it has cv_limit_kPa, "),
        ({"dead_man_ms": 900.0}, "dead_man_ms is from 50 to 300, not 900"),
        ({"dead_man_ms": float("nan")}, "not nan"),
        ({"cv_limit_kPa": 25.0, "dead_man_ms": 900.0}, "dead_man_ms is from"),
    ],
)
def test_an_impossible_change_is_reported_before_anything_is_changed(
    changes: dict[str, float], says: str
) -> None:
    board = Board()
    talk = board.talk(changes)
    assert says in talk.problem
    assert not talk.done
    assert not [message for message in board.asked if isinstance(message, SetSetting)]


def test_a_refusal_ends_it() -> None:
    talk = SettingsTalk({"a": 2.0})
    assert talk.due(0.0) == [GetSetting(0)]
    talk.receive(Setting(0, 1, "a", 1.0, 0.0, 5.0, 1.0))
    assert talk.due(0.0) == [SetSetting(0, 2.0)]
    # A refusal with a number belongs to a setpoint.
    talk.receive(Refusal(7, RefusalReason.OUT_OF_RANGE))
    assert not talk.problem
    talk.receive(Refusal(0, RefusalReason.REGULATING))
    assert talk.problem.startswith("the firmware refuses to set a: regulating")
    assert talk.due(10.0) == []


def test_a_setting_that_does_not_take_the_value_is_not_done() -> None:
    talk = SettingsTalk({"a": 2.0})
    talk.due(0.0)
    talk.receive(Setting(0, 1, "a", 1.0, 0.0, 5.0, 1.0))
    talk.due(0.0)
    talk.receive(Setting(0, 1, "a", 1.0, 0.0, 5.0, 1.0))
    assert not talk.done
    talk.receive(Setting(0, 1, "a", 2.0, 0.0, 5.0, 1.0))
    assert talk.done


def test_nobody_is_asked_for_ever() -> None:
    talk = SettingsTalk()
    asked = [t for t in range(1000) if talk.due(t / 10)]
    assert 5 <= len(asked) <= 20
    assert "does not answer" in talk.problem

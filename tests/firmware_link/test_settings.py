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
    Welcome,
)
from firmware_link.settings import SettingsExchange, digest
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

    def exchange(self, changes: Mapping[str, float] | None = None, lose_every: int = 0) -> SettingsExchange:
        """Talk until the end. Every `lose_every`th request is lost."""
        exchange = SettingsExchange(changes)
        for _ in range(400):
            self._t += 0.1
            for message in exchange.due(self._t):
                self.asked.append(message)
                if not lose_every or len(self.asked) % lose_every:
                    self.firmware.receive(self._codec.encode(message))
            for answer in self._answers.decode(self.firmware.take_output()):
                exchange.receive(answer)
            if exchange.done or exchange.problem:
                return exchange
        raise AssertionError("it does not end")


def test_all_are_read_in_order() -> None:
    board = Board()
    exchange = board.exchange()
    assert exchange.done
    count = exchange.settings[0].count
    assert [setting.id for setting in exchange.settings] == list(range(count))
    assert board.asked == [GetSetting(number) for number in range(count)]
    assert exchange.settings[0].name == "cv_limit_kPa"
    assert exchange.settings[0].value == 30.0


def test_the_digest_is_that_of_the_welcome() -> None:
    board = Board()
    same: tuple[dict[str, float], ...] = ({}, {"cv_zero_kPa": -0.0})
    for changes in (*same, {"cv_limit_kPa": 25.3, "dead_man_ms": 200.0}):
        exchange = board.exchange(changes)
        assert (digest(exchange.before) == digest(exchange.settings)) == (changes in same)
        board.firmware.receive(Codec().encode(Hello(PROTOCOL_VERSION, 1)))
        answers = Codec().decode(board.firmware.take_output())
        assert [m.settings_digest for m in answers if isinstance(m, Welcome)] == [digest(exchange.settings)]


def test_a_lost_request_is_repeated() -> None:
    whole, holey = Board().exchange(), Board().exchange({"cv_limit_kPa": 25.0}, lose_every=3)
    assert holey.done
    assert holey.settings[0].value == 25.0
    assert holey.settings[1:] == whole.settings[1:]


def test_changes_are_made_and_kept() -> None:
    board = Board()
    exchange = board.exchange({"cv_limit_kPa": 25.3, "dead_man_ms": 200.0})
    assert exchange.done
    assert board.firmware.settings["dead_man_ms"] == 200
    assert board.firmware.settings["cv_limit_kPa"] == pytest.approx(25.3)
    board.firmware.reset()
    assert board.firmware.settings["dead_man_ms"] == 200


def test_each_setting_takes_a_fraction_or_refuses_it() -> None:
    """The host must know each setting that the firmware rounds: otherwise its change never succeeds."""
    for setting in Board().exchange().settings:
        fraction = setting.least + 0.301 * (setting.most - setting.least)
        exchange = Board().exchange({setting.name: fraction})
        assert exchange.done or "must be a whole number" in exchange.problem, setting.name


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"cv_limit": 25.0}, "no setting cv_limit; did you mean cv_limit_kPa?"),
        ({"colour": 1.0}, "no setting colour: it has cv_limit_kPa, "),
        ({"dead_man_ms": 900.0}, "dead_man_ms must be from 50 to 300, not 900"),
        ({"dead_man_ms": float("nan")}, "not nan"),
        ({"dead_man_ms": 200.25}, "dead_man_ms must be a whole number, not 200.25"),
        ({"cv_limit_kPa": 25.5, "telemetry_Hz": 100.5}, "telemetry_Hz must be a whole number, not 100.5"),
        ({"cv_limit_kPa": 25.0, "dead_man_ms": 900.0}, "dead_man_ms must be from"),
    ],
)
def test_an_impossible_change_is_reported_before_anything_is_changed(
    changes: dict[str, float], says: str
) -> None:
    board = Board()
    exchange = board.exchange(changes)
    assert says in exchange.problem
    assert not exchange.done
    assert not [message for message in board.asked if isinstance(message, SetSetting)]


def test_a_refusal_ends_it() -> None:
    exchange = SettingsExchange({"a": 2.0})
    assert exchange.due(0.0) == [GetSetting(0)]
    exchange.receive(Setting(0, 1, "a", 1.0, 0.0, 5.0, 1.0))
    assert exchange.due(0.0) == [SetSetting(0, 2.0)]
    # A refusal with a number belongs to a setpoint.
    exchange.receive(Refusal(7, RefusalReason.OUT_OF_RANGE))
    assert not exchange.problem
    exchange.receive(Refusal(0, RefusalReason.REGULATING))
    assert exchange.problem.startswith("the firmware refuses to set a: regulating")
    assert exchange.due(10.0) == []


def test_a_setting_that_does_not_take_the_value_is_not_done() -> None:
    exchange = SettingsExchange({"a": 2.0})
    exchange.due(0.0)
    exchange.receive(Setting(0, 1, "a", 1.0, 0.0, 5.0, 1.0))
    exchange.due(0.0)
    exchange.receive(Setting(0, 1, "a", 1.0, 0.0, 5.0, 1.0))
    assert not exchange.done
    exchange.receive(Setting(0, 1, "a", 2.0, 0.0, 5.0, 1.0))
    assert exchange.done


def test_requests_end_after_some_attempts() -> None:
    exchange = SettingsExchange()
    asked = [t for t in range(1000) if exchange.due(t / 10)]
    assert 5 <= len(asked) <= 20
    assert "does not answer" in exchange.problem

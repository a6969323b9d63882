"""Checks that the phloSAR answers on the port. If it does not, finds the probable reason."""

from __future__ import annotations

from collections.abc import Sequence

from firmware_link.protocol import DeviceMessage, HostMessage, Message, Refusal, Welcome

ANSWER_WITHIN_S = 3.0
"""The time of six greetings; longer than a board takes to start."""


class AnswerCheck:
    """Checks, after each opening of the port, that our greeting is answered."""

    def __init__(self) -> None:
        self._opened_s: float | None = None
        self._answered = False
        self._bytes_came = False
        self._messages_came = self._own_came = False
        self._reported = ""

    def opened(self, t: float) -> None:
        self._opened_s = t
        self._answered = self._bytes_came = self._messages_came = self._own_came = False
        self._reported = ""

    def closed(self) -> None:
        self._opened_s = None

    def received(self, data: bytes, messages: Sequence[Message]) -> None:
        """Note received bytes and the messages in them."""
        self._bytes_came |= bool(data)
        self._messages_came |= any(isinstance(message, DeviceMessage) for message in messages)
        self._own_came |= any(isinstance(message, HostMessage) for message in messages)
        # Firmware of another version also answers. Then the session reports the problem.
        if not self._answered:
            self._answered = any(isinstance(message, (Welcome, Refusal)) for message in messages)

    def news(self, t: float) -> str | None:
        """A sentence when the answer is missing, an empty text when it has come; None without a change."""
        if self._opened_s is None:
            return None
        waited = not self._answered and t - self._opened_s >= ANSWER_WITHIN_S
        problem = self._silence() if waited else ""
        if problem == self._reported:
            return None
        self._reported = problem
        return problem

    def _silence(self) -> str:
        if self._messages_came:
            return (
                "telemetry arrives, but no answer: the line from us to the board is broken,"
                " or another program reads this port, too"
            )
        if self._own_came:
            return (
                "this port returns what we send: no board is on it, its lines RX and TX are connected,"
                " or it is a terminal"
            )
        if self._bytes_came:
            return (
                "bytes arrive, but no message of the phloSAR: this is another device,"
                " or its firmware is not ours, or the baud rate is wrong"
            )
        return "the port is open but silent: is it the phloSAR's, and is its firmware flashed and running?"

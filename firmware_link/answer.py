"""Is it the phloSAR that is on the port? If nobody greets back, what kind of silence that is."""

from __future__ import annotations

from collections.abc import Sequence

from firmware_link.protocol import Message, Refusal, Welcome

PATIENCE_S = 3.0
"""Six greetings, and longer than a board takes to start."""


class Answer:
    """Watches one opening of a port after another for an answer to our greeting."""

    def __init__(self) -> None:
        self._opened_s: float | None = None
        self._answered = False
        self._bytes_came = False
        self._messages_came = False
        self._told = ""

    def opened(self, t: float) -> None:
        self._opened_s = t
        self._answered = self._bytes_came = self._messages_came = False
        self._told = ""

    def closed(self) -> None:
        self._opened_s = None

    def received(self, data: bytes, messages: Sequence[Message]) -> None:
        """What came, and the messages that were in it."""
        self._bytes_came |= bool(data)
        self._messages_came |= bool(messages)
        # Firmware of another version answers as well; the session says what is wrong with it.
        self._answered |= any(isinstance(message, (Welcome, Refusal)) for message in messages)

    def news(self, t: float) -> str | None:
        """A sentence once it is to be told that nobody answers, and empty once that is over; else None."""
        if self._opened_s is None:
            return None
        waited = not self._answered and t - self._opened_s >= PATIENCE_S
        problem = self._silence() if waited else ""
        if problem == self._told:
            return None
        self._told = problem
        return problem

    def _silence(self) -> str:
        if self._messages_came:
            return (
                "telemetry comes, but no answer: the line from us to the board is broken,"
                " or another program reads this port, too"
            )
        if self._bytes_came:
            return (
                "bytes come, but no message of the phloSAR's: this is another device,"
                " or its firmware is not ours, or the baud rate is wrong"
            )
        return "the port is open but silent: is it the phloSAR's, and is its firmware flashed and running?"

"""Reads and changes the firmware's settings over a real port."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence

from firmware_link.host import SessionState
from firmware_link.protocol import Setting
from firmware_link.settings import SettingsExchange, digest
from flying_vines.config.address import Address
from flying_vines.service.link_watch import LinkWatch
from flying_vines.service.persistent_state import PersistentState, PersistentStateError

ANSWERS_WITHIN_S = 5.0
"""Maximum time without a ready board: long enough for a restart, a second Hello, and the text about a silent
port."""


class SettingsError(Exception):
    """The settings cannot be read or changed; the text is a sentence."""


class SettingsInterruptedError(SettingsError):
    """The user has stopped the operation."""


async def exchange_settings(
    address: Address,
    changes: Mapping[str, float],
    stopped: asyncio.Event,
    state: PersistentState | None = None,
) -> Sequence[Setting]:
    """Make the changes and return all settings. Raises `SettingsError`, also if `stopped` is set.

    The changes of a person need no other confirmation: the service with this `state` knows the new settings,
    if it knew those before.
    """
    exchange = SettingsExchange(changes)
    watch = LinkWatch(address, exchange)
    ready_s = 0.0

    def over() -> bool:
        nonlocal ready_s
        if watch.monitor.session.state is SessionState.READY:
            ready_s = watch.t
        gone = watch.t - ready_s >= ANSWERS_WITHIN_S
        return exchange.done or bool(exchange.problem) or gone or stopped.is_set()

    await watch.run(lambda events: None, over)
    if not exchange.done:
        if stopped.is_set() and not exchange.problem:
            raise SettingsInterruptedError("interrupted")
        raise SettingsError(exchange.problem or watch.port.text)
    if changes and state is not None and digest(exchange.before) == state.read_board_settings():
        try:
            state.store_board_settings(digest(exchange.settings))
        except PersistentStateError as error:
            raise SettingsError(str(error)) from None
    return exchange.settings

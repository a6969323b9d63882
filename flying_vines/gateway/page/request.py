"""What a browser may say: one small object, and not too many of them."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from flying_vines.gateway.messages import Ask
from flying_vines.vine.intent import Command

LONGEST_WISH = 512
"""In bytes."""
MOST_PER_S = 20.0
MOST_AT_ONCE = 40.0


class Wish(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Somebody presses a button. The answer bears its `id`."""

    id: Annotated[int, Meta(ge=0, le=2**53)]
    command: Command
    value: float | None = None
    name: Annotated[str, Meta(max_length=100)] | None = None
    made_at: float | None = None
    """When it was pressed, by the clock of the snapshots."""
    seen_at: float | None = None
    """The `t` of the latest snapshot that was shown then."""


def read_wish(text: str) -> Wish:
    """Raises `msgspec.DecodeError`, or `ValueError` where it is nothing that can be asked for."""
    wish = _WISH.decode(text)
    Ask(0, "page", wish.command, wish.value, wish.name)
    return wish


_WISH = msgspec.json.Decoder(Wish)

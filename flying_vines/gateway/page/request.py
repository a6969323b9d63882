"""A browser's request: one small object, at a limited rate."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from flying_vines.gateway.messages import Request
from flying_vines.vine.intent import CommandName

MAX_REQUEST_BYTES = 512
MAX_PER_S = 20.0
MAX_AT_ONCE = 40.0


class PageRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A pressed button. The answer has the same `id`."""

    id: Annotated[int, Meta(ge=0, le=2**53)]
    command: CommandName
    value: float | None = None
    name: Annotated[str, Meta(max_length=100)] | None = None
    made_at: float | None = None
    """Time of the press, on the clock of the snapshots."""
    seen_at: float | None = None
    """The `t` of the snapshot that was shown at that time."""


def read_request(text: str) -> PageRequest:
    """Raises `msgspec.DecodeError`, or `ValueError` for an invalid command."""
    request = _REQUEST.decode(text)
    Request(0, "page", request.command, request.value, request.name)
    return request


_REQUEST = msgspec.json.Decoder(PageRequest)

"""Reads the TOML files of the design guide. An error is one line that names file, line and key."""

from __future__ import annotations

from typing import Any

import msgspec

from flying_vines.config.config import ConfigError
from flying_vines.files.toml_text import explained, located, parsed


def decode(text: str, source: str, kind: Any) -> Any:
    """The text of a file as the msgspec type `kind`.

    Args:
        text: TOML.
        source: its name in errors.
        kind: a type that msgspec converts to.

    Raises `ConfigError`.
    """
    raw = parsed(text, source, ConfigError)
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        key, reason = explained(str(error), kind, raw=raw)
        raise ConfigError(located(text, source, key, reason)) from None

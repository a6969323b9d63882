"""TOML files of the design guide, checked: what is wrong is one line that names file, line and key."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from flying_vines.config import ConfigError
from flying_vines.toml_text import dotted, key_of, place


def text_of(path: Path) -> str:
    """The text of a file.

    Raises `ConfigError` where it cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: cannot be read: it is not a UTF-8 text file") from None


def decode(text: str, source: str, kind: Any, known: Sequence[str] = ()) -> Any:
    """The text of a file as the msgspec type `kind`.

    Args:
        text: TOML.
        source: what errors call it.
        kind: a type that msgspec converts to; the caller knows what comes back.
        known: keys that a mistyped one may have meant.

    Raises `ConfigError`.
    """
    try:
        raw = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(f"{source}: not TOML: {error}") from None
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        raise _explain(text, source, str(error), known) from None


def _explain(text: str, source: str, error: str, known: Sequence[str]) -> ConfigError:
    message, _, path = error.partition(" - at ")
    key = key_of(path)
    unknown = re.search(r"unknown field `(.+?)`", message)
    if unknown:
        key = (*key, unknown[1])
        near = difflib.get_close_matches(unknown[1], known, n=1)
        message = "unknown key" + (f"; did you mean '{near[0]}'?" if near else "")
    missing = re.search(r"missing required field `(.+?)`", message)
    if missing:
        message = f"'{missing[1]}' is missing"
    message = message.replace("`", "").replace("Expected", "expected")
    name = dotted(key)
    return ConfigError(f"{place(text, source, key)}: {name + ': ' if name else ''}{message}")

"""Writes a configuration as TOML text, for configurations that a program makes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from flying_vines.config.config import Config
from flying_vines.config.toml_edit import table_lines, value_text


def configuration_text(config: Config) -> str:
    """The TOML text that `config.parse` reads as this configuration."""
    return "\n".join(_tables(msgspec.to_builtins(config))) + "\n"


def _tables(raw: Mapping[str, Any]) -> Iterator[str]:
    for name, content in raw.items():
        if name in ("items", "triggers"):
            for element in content:
                yield from (*table_lines(f"[{name}]", element), "")
        elif name == "profiles":
            for profile, segments in content.items():
                yield from (*table_lines(f"profiles.{value_text(profile)}", segments), "")
        else:
            yield from (*table_lines(name, content), "")

"""Writes measured values into the user's configuration. Only the lines of these keys change."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from firmware_link.protocol import Setting
from flying_vines.calibration.findings import Findings, MeasuredQuantity, SettingProposal
from flying_vines.config import config as configuration
from flying_vines.config.config import Config, ConfigError
from flying_vines.config.toml_edit import value_text, with_value
from flying_vines.files.toml_text import lines_of_keys
from flying_vines.vine.curve import BendCurve

MAX_RELATIVE_WIDTH = 0.25
"""Maximum half-width of an interval, relative to the value. A less precise result changes no key."""


@dataclass(frozen=True)
class ConfigurationChange:
    """A new value for one key of the configuration."""

    table: str
    name: str
    value: Any
    why: str
    """For the comment, for example the interval."""


def changes(findings: Findings, max_kPa: float) -> Iterator[ConfigurationChange]:
    """The findings that go into a configuration, rounded to their precision.

    A curve is cut at `max_kPa`, the configuration's limit: a measured pressure may be slightly above it.
    """
    for finding in findings.findings:
        if finding.key is not None and is_precise(finding):
            table, name = finding.key.split(".")
            if table != "vine":
                value, interval = finding.texts()
                yield ConfigurationChange(table, name, float(value), interval)
    source = f"{len(findings.pairs)} angles" if findings.pairs else "fitted to a file of pairs"
    if findings.curve:
        pairs = [[round(kPa, 3), round(deg, 2)] for kPa, deg in _up_to(max_kPa, findings.curve)]
        yield ConfigurationChange("vine", "curve", pairs, source)
    if findings.hysteresis_kPa is not None:
        yield ConfigurationChange("vine", "hysteresis_kPa", findings.hysteresis_kPa, source)


def _up_to(max_kPa: float, curve: Sequence[tuple[float, float]]) -> Sequence[tuple[float, float]]:
    if curve[-1][0] <= max_kPa:
        return curve
    within = [pair for pair in curve if pair[0] < max_kPa]
    return [*within, (max_kPa, BendCurve(curve).angle_deg(max_kPa))]


def is_precise(finding: MeasuredQuantity) -> bool:
    """True if the measured value may replace the assumed one."""
    if finding.interval is None:
        return False
    value, low, high = finding.interval
    return low > 0.0 and high - low <= 2.0 * MAX_RELATIVE_WIDTH * value


def with_changes(text: str, source: str, changed: Sequence[ConfigurationChange], day: str) -> str:
    """The configuration's text with these values. Comments give the old values and the day.

    Raises `ConfigError` if the configuration does not have one key per line, or if it is invalid with the
    measured values.
    """
    before = configuration.parse(text, source)
    edited = text
    for change in changed:
        table = getattr(before, change.table)
        was = value_text(msgspec.to_builtins(getattr(table, change.name)))
        remark = f"was {was}, measured {day}: {change.why}".replace(";", ",")
        edited = with_value(edited, change.table, change.name, value_text(change.value), remark)
    if not _holds(edited, with_numbers(before, changed)):
        names = ", ".join(f"{change.table}.{change.name}" for change in changed)
        raise ConfigError(f"{source}: does not have one key per line: set {names} by hand")
    configuration.parse(edited, f"{source}, calibrated")
    return edited


def _holds(text: str, config: Config) -> bool:
    try:
        return msgspec.convert(tomllib.loads(text), Config) == config
    except tomllib.TOMLDecodeError:
        return False


def calibrated(text: str, source: str, found: Sequence[ConfigurationChange], day: str) -> tuple[str, str]:
    """As `with_changes`, and a sentence if the measured curve was written only as a comment.

    The curve becomes a comment if the configuration would be invalid with it, for example because a profile
    has an angle that the vine cannot reach.
    """
    try:
        return with_changes(text, source, found, day), ""
    except ConfigError as error:
        curve = [change for change in found if change.table == "vine"]
        if not curve:
            raise
        rest = [change for change in found if change.table != "vine"]
        why = str(error).partition(": ")[2]
    lines = with_changes(text, source, rest, day).split("\n")
    comments = [f"# {change.name} = {value_text(change.value)}" for change in curve]
    place = lines_of_keys(text).get(("vine",), len(lines))
    lines[place:place] = [f"# Measured {day}, but not used: {why}", *comments]
    return "\n".join(lines), f"The measured curve is only a comment in the configuration: {why}"


def with_numbers(config: Config, found: Sequence[ConfigurationChange]) -> Config:
    """The configuration with these values; not validated."""
    for change in found:
        table = getattr(config, change.table)
        values = {**msgspec.to_builtins(table), change.name: change.value}
        config = msgspec.structs.replace(config, **{change.table: msgspec.convert(values, type(table))})
    return config


def proposed(proposals: Sequence[SettingProposal], settings: Sequence[Setting]) -> Mapping[str, float]:
    """The proposed values of settings that the firmware has, within its limits."""
    now = {setting.name: setting for setting in settings}
    wanted = {}
    for proposal in proposals:
        setting = now.get(proposal.setting)
        if setting is not None:
            value = proposal.value + (setting.value if proposal.relative else 0.0)
            wanted[proposal.setting] = min(max(round(value, 4), setting.least), setting.most)
    return wanted

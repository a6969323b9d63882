"""Extreme values for every number of a configuration and of a rig file: refused in one line, or usable."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from examples import examples
from firmware_link.protocol import PROTOCOL_VERSION, Fault, Mode, Telemetry, Welcome
from flying_vines.config import config as configuration
from flying_vines.config.config import Config, ConfigError, PneumaticsConfig
from flying_vines.config.toml_edit import value_text
from flying_vines.core.core import Core
from flying_vines.core.events import Asked, FirmwareMessage, LinkChanged, Tick
from flying_vines.physics.effects import catalogue
from flying_vines.physics.plant.true_rig import load_true_rig
from flying_vines.physics.rig import Hose, Rig, RigError
from flying_vines.supply import RigPrior, nominal
from flying_vines.supply.rig_file_prior import load_rig_file_prior
from flying_vines.vine.intent import StartProfile, VentVine

EXTREME = (
    "1e-308", "1e308", "-1e308", "5e-324", "nan", "inf", "-inf", "-0.0", "0", "-1", "1e-12", "1e-5", "1e-3",
    "0.1", "1.0", "1000.0", "1e5", "1e9", "1e18", str(2**63 - 1), str(2**63), "9" * 400, "9" * 5000,
    "'" + "x" * 100_000 + "'", "true", "[]", "{}", "1979-05-27", "0x" + "f" * 4000,
)  # fmt: skip


def numbers_in(value: Any, at: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """The keys of all numbers."""
    inner: Any = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield at
    for key, part in inner:
        yield from numbers_in(part, (*at, key))


def with_mark(value: Any, at: tuple[str | int, ...]) -> Any:
    """The tables with `MARK` at a key."""
    if not at:
        return MARK
    if isinstance(value, dict):
        return {k: with_mark(v, at[1:]) if k == at[0] else v for k, v in value.items()}
    return [with_mark(v, at[1:]) if k == at[0] else v for k, v in enumerate(value)]


MARK = 123456.789
BUILT_IN = configuration.default()
TABLES: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(BUILT_IN))
KEYS = list(numbers_in(TABLES))


def config_with(at: tuple[str | int, ...], text: str) -> str:
    tables = with_mark(TABLES, at)
    made = "\n".join(
        f"{name} = {value_text(part)}" for name, part in tables.items() if name not in ("items", "triggers")
    )
    items = ", ".join(value_text(item) for item in tables["items"])
    return f"{made}\nitems = [{items}]\n".replace(str(MARK), text)


def flies(config: Config, prior: RigPrior) -> None:
    """The start of the service with a board that sends telemetry, and a request: nothing raises."""
    core = Core(config, prior=prior)
    core.handle(LinkChanged(0.0, "firmware", True))
    core.handle(Tick(0.0))
    hello = Welcome(PROTOCOL_VERSION, core._firmware._nonce, 1, "x", 1, 30.0, 28.0, 760.0, 200.0, 300, 100)
    core.handle(FirmwareMessage(0.01, hello))
    for step in range(1, 40):
        t = 0.05 * step
        kPa = 20.0 * (step % 10 > 5)
        told = Telemetry(
            50 * step, Mode.REGULATE, Fault(0), 0, kPa, kPa, 600.0 - step, 0.5, 0.2, step % 2 == 0
        )
        core.handle(FirmwareMessage(t, told))
        core.handle(Tick(t))
        if step == 10:
            core.handle(Asked(t, "page", StartProfile("bend-full")))
        if step == 30:
            core.handle(Asked(t, "page", VentVine()))


@given(at=st.sampled_from(KEYS), text=st.sampled_from(EXTREME))
@example(at=("pneumatics", "evp_flow_resistance_kPa_s_per_SL"), text="1e-308")
@example(at=("pneumatics", "reservoir_volume_L"), text="2000.0")
@example(at=("pneumatics", "cv_volume_L"), text="100.0")
@settings(max_examples=examples(600), deadline=None)
def test_an_extreme_number_of_the_configuration(at: tuple[str | int, ...], text: str) -> None:
    try:
        config = configuration.parse(config_with(at, text), "my.toml")
    except ConfigError as error:
        said = str(error)
        assert said.startswith("my.toml")
        assert "\n" not in said and len(said) < 3000
        assert "Expected" not in said and "`" not in said
        return
    prior = nominal(config.pneumatics)
    assert all(map(math.isfinite, prior.rise + prior.flat + prior.venturi))
    flies(config, prior)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (
            "reservoir_volume_L = 2000",
            "pneumatics.reservoir_volume_L: must be a number from 0.01 to 200, not 2000",
        ),
        ("cv_volume_L = 100", "pneumatics.cv_volume_L: must be a number from 0.001 to 50, not 100"),
        ("full_kPa = 1e308", "pneumatics.full_kPa: must be a number from 10 to 5000, not 1e+308"),
        (
            "evp_flow_resistance_kPa_s_per_SL = 1e-308",
            "pneumatics.evp_flow_resistance_kPa_s_per_SL: must be a number from 10 to 1000000, not 1e-308",
        ),
    ],
)
def test_the_error_names_line_value_and_range(line: str, says: str) -> None:
    text = f"[pneumatics]\n{line}\n[profiles.x]\nsegments = [{{kind = 'step', to_kPa = 0}}]"
    with pytest.raises(ConfigError) as refused:
        configuration.parse(text, "my.toml")
    assert str(refused.value) == f"my.toml:2: {says}"


RIG_TABLES = {
    name: {key: number for key, number in table.items() if number is not None}
    for name, table in asdict(Rig(hose=Hose())).items()
    if table and name not in ("gas", "tolerance_percent")
} | {"gas": {"gamma": 1.4, "molar_mass_g_per_mol": 28.96}, "tolerance_percent": {"cv.volume_L": 1.0}}
RIG_KEYS = [(name, key) for name, table in RIG_TABLES.items() for key in table]
CAUSE_KEYS = [(cause.name, p.name) for cause in catalogue() for p in cause.parameters]


def toml(tables: dict[str, dict[str, Any]]) -> str:
    return "\n".join(
        f"[{name}]\n" + "".join(f'"{key}" = {value}\n' for key, value in table.items())
        for name, table in tables.items()
    )


def accepted_or_one_line(path: Path, text: str) -> None:
    path.write_text(text)
    pneumatics = PneumaticsConfig()
    try:
        load_true_rig(path)
        prior = load_rig_file_prior(path, pneumatics).prior
    except RigError as error:
        assert str(path) in str(error)
        assert "\n" not in str(error) and len(str(error)) < 3000
        return
    assert all(map(math.isfinite, prior.rise + prior.flat + prior.venturi + prior.leak + prior.cv_leak)), text
    flies(msgspec.structs.replace(BUILT_IN, pneumatics=prior.pneumatics), prior)


@given(key=st.sampled_from(RIG_KEYS), text=st.sampled_from(EXTREME), likely=st.booleans())
@settings(
    max_examples=examples(300), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_an_extreme_number_of_a_rig(tmp_path: Path, key: tuple[str, str], text: str, likely: bool) -> None:
    tables = {name: dict(table) for name, table in RIG_TABLES.items()}
    tables[key[0]][key[1]] = text
    if likely:
        tables["effects"] = {"likely": "true"}
    accepted_or_one_line(tmp_path / "rig.toml", toml(tables))


@given(key=st.sampled_from(CAUSE_KEYS), text=st.sampled_from(EXTREME))
@settings(
    max_examples=examples(300), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_an_extreme_number_of_a_cause(tmp_path: Path, key: tuple[str, str], text: str) -> None:
    (cause,) = (cause for cause in catalogue() if cause.name == key[0])
    values: dict[str, Any] = {p.name: p.seeds[0] for p in cause.parameters} | {key[1]: text}
    rig: dict[str, dict[str, Any]] = {"cv": {}, "hose": {}} if "hose" in cause.needs else {"cv": {}}
    accepted_or_one_line(tmp_path / "rig.toml", toml({**rig, f"causes.{cause.name}": values}))

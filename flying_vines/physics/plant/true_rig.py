"""A rig file that also describes the real rig: nominal numbers, causes and effects.

    [cv]                                        nominal numbers, as in any rig.toml
    volume_L = 0.1
    [causes.cv_leak]                            a cause of the rig-data format, by name
    flow_resistance_kPa_s_per_SL = 300
    [effects]
    likely = true                               all probable effects of a real rig, with its sensors …
    without = ["cv_shape"]                      … except these
    [effects.evp_law]                           one effect; `kind` if there are several kinds
    kind = "iso6358"
    sonic_conductance_SL_per_s_kPa = 4.95e-4

Without `[causes]` and `[effects]` this is a plain rig file: the real rig is nominal. An empty `[causes]`
means that a diagnosis has found no cause.
"""

from __future__ import annotations

import json
import math
import types
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_args, get_type_hints

import msgspec

from flying_vines.physics.cause import Parameter
from flying_vines.physics.effects import NONE, catalogue, cause_named
from flying_vines.physics.plant.effects import Effects, likely_effects
from flying_vines.physics.plant.plant import Setup, perfect
from flying_vines.physics.plant.sensors import HONEYWELL_15BAR, HONEYWELL_30PSI, Adc, Sensor
from flying_vines.physics.rig import WITHOUT_PUMP, Rig, RigError, Sensors, number_error, read_rig, rig_from

_EFFECTS: dict[str, dict[str, type]] = {
    name: {kind.__name__.lower(): kind for kind in get_args(hint) if kind is not types.NoneType}
    for name, hint in get_type_hints(Effects).items()
}
"""For each field of `Effects`: its possible types, by their `kind` in a rig file."""
_POSITIVE = ("gain", "scale")
FAR = 10_000.0
"""A cause's parameter in a rig file may be this many times outside the bounds of a fit."""
TINY, HUGE = 1e-12, 1e12
"""Sizes of an effect's numbers. The smallest conductance of a rig is 1e-9, its largest constant 1e10."""
DEFINED_IN = "defined_in"
"""Key of a cause's file or package, if it is from outside this project."""


@dataclass(frozen=True)
class TrueRig:
    """A nominal rig, and the causes and effects of the real one. `setup` is the real rig.

    `effects` are those that the file gives one by one; they replace the likely ones of the same names. A
    cause that sets parameters of an existing effect leaves the other parameters as they are (see
    `Setup.with_effects`).
    """

    nominal: Rig = field(default_factory=Rig)
    causes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    effects: Effects = field(default_factory=Effects)
    likely: bool = False
    without: tuple[str, ...] = ()
    """Likely effects that this rig does not have."""
    none_found: bool = False
    """True if a diagnosis was made and found no cause."""

    @property
    def complete(self) -> bool:
        """True if this describes the real rig, and not only the nominal one."""
        return bool(self.causes or self.likely or self.none_found or self.effects != Effects())

    def __post_init__(self) -> None:
        # Impossible combinations raise their error here.
        _ = self.setup

    @cached_property
    def setup(self) -> Setup:
        """The plant and its sensors."""
        own = {f.name: value for f in fields(Effects) if (value := getattr(self.effects, f.name)) is not None}
        try:
            if self.likely:
                own = {**vars(likely_effects()), **dict.fromkeys(self.without), **own}
            made = perfect(self.nominal, Effects(**own))
            if self.likely:
                made = Setup(made.plant, *likely_sensors(self.nominal.sensors))
        except (ValueError, ArithmeticError) as error:
            raise RigError(f"effects: {error}.") from None
        for name, parameters in self.causes.items():
            made = _caused(made, name, parameters)
        return made


def likely_sensors(noise: Sensors) -> tuple[Sensor, Sensor]:
    """Sensors of control volume and reservoir, with the firmware's converter."""
    adc = Adc(bits=12)
    return (
        replace(HONEYWELL_30PSI, noise_std_kPa=noise.cv_noise_std_kPa, adc=adc),
        replace(HONEYWELL_15BAR, noise_std_kPa=noise.reservoir_noise_std_kPa, adc=adc),
    )


def load_true_rig(path: Path | str) -> TrueRig:
    """The nominal and the real rig in a TOML file.

    RigError if the file cannot be read, or has an unknown key or an impossible number.
    """
    return read_rig(path, true_rig_from)


def true_rig_from(content: Mapping[str, Any]) -> TrueRig:
    """The rig in a decoded TOML file; see `load_true_rig`."""
    rig = rig_from({key: value for key, value in content.items() if key not in ("causes", "effects")})
    causes = _table(content.get("causes", {}), "causes")
    effects = dict(_table(content.get("effects", {}), "effects"))
    likely, without = effects.pop("likely", False), effects.pop("without", [])
    if not isinstance(likely, bool):
        raise RigError("effects.likely must be true or false.")
    if not (isinstance(without, list) and all(str(name) in _EFFECTS for name in without)):
        raise RigError(f"effects.without must be a list of effects: {', '.join(_EFFECTS)}.")
    if without and not likely:
        raise RigError("effects.without removes likely effects: it needs likely = true.")
    for name in effects:
        if name not in _EFFECTS:
            raise RigError(f"effects.{name} is not an effect: the effects are {', '.join(_EFFECTS)}.")
    return TrueRig(
        nominal=rig,
        causes={name: _parameters(name, value) for name, value in causes.items()},
        effects=_checked_effects({name: _effect(name, value) for name, value in effects.items()}),
        likely=likely,
        without=tuple(without),
        none_found=content.get("causes") == {},
    )


def true_rig_text(rig: TrueRig) -> str:
    """The rig as the text of a rig file."""
    nominal, default = asdict(rig.nominal), asdict(Rig())
    tables = [
        (name, {key: number for key, number in table.items() if number is not None})
        for name, table in nominal.items()
        if table
        and not (name == "gas" and table == default[name])
        and not (rig.nominal.pump and name in WITHOUT_PUMP)
    ]
    for name, parameters in rig.causes.items():
        outside = cause_named(name).defined_in
        tables.append((f"causes.{name}", {**parameters, **({DEFINED_IN: outside} if outside else {})}))
    if rig.none_found:
        tables.append(("causes", {}))
    if rig.likely:
        tables.append(("effects", {"likely": True, **({"without": rig.without} if rig.without else {})}))
    for name, kinds in _EFFECTS.items():
        effect = getattr(rig.effects, name)
        if effect is not None:
            kind = {"kind": type(effect).__name__.lower()} if len(kinds) > 1 else {}
            tables.append((f"effects.{name}", {**kind, **_not_default(effect)}))
    return "\n".join(_toml(name, values) for name, values in tables)


def _not_default(effect: Any) -> dict[str, Any]:
    """The parameters of an effect that differ from their defaults."""
    return {f.name: v for f in fields(effect) if (v := getattr(effect, f.name)) != f.default}


def _caused(made: Setup, name: str, parameters: Mapping[str, float]) -> Setup:
    """The setup with a cause."""
    where = f"causes.{name}"
    try:
        cause = cause_named(name)
    except KeyError:
        names = ", ".join(cause.name for cause in (NONE, *catalogue()))
        raise RigError(f"{where} is not a cause: the causes are {names}.") from None
    for table in cause.needs:
        if not made.plant.rig.has(table):
            what = {"cv": "a control volume"}.get(table, f"a {table}")
            raise RigError(f"{where} needs {what}, and the rig has no [{table}].")
    known = [parameter.name for parameter in cause.parameters]
    for parameter, value in parameters.items():
        if parameter not in known:
            raise RigError(f"{where}.{parameter} is not a parameter: {_listed(known)}.")
        if parameter in _POSITIVE and not value > 0.0:
            raise RigError(f"{where}.{parameter} is {value:g}, and must be above 0.")
    for stated in cause.parameters:
        if stated.name not in parameters:
            raise RigError(f"{where}.{stated.name} is missing.")
        value = parameters[stated.name]
        low, high = _generous(stated)
        if value != stated.neutral and not low <= value <= high:
            raise RigError(f"{where}.{stated.name} must be a number from {low:g} to {high:g}, not {value:g}.")
    try:
        caused = cause.put_into(made, parameters)
        # The cause may have set a number of the rig outside its range.
        msgspec.convert(asdict(caused.plant.rig), Rig)
        return caused
    except msgspec.ValidationError:
        raise RigError(f"{where} makes the rig impossible: {_as_text(parameters)}.") from None
    except (ValueError, ArithmeticError) as error:
        raise RigError(f"{where}: {error}.") from None


def _generous(parameter: Parameter) -> tuple[float, float]:
    """Bounds far outside those of a fit, within which no arithmetic overflows."""
    if parameter.logarithmic:
        return parameter.low / FAR, parameter.high * FAR
    far = FAR * max(abs(parameter.low), abs(parameter.high))
    return (-far if parameter.low < 0.0 else 0.0), far


def _parameters(name: str, value: Any) -> dict[str, float]:
    """The parameters of a cause. RigError if its file or package is missing."""
    table = dict(_table(value, f"causes.{name}"))
    outside = table.pop(DEFINED_IN, None)
    if outside is not None and name not in {cause.name for cause in catalogue()}:
        package = str(outside).removeprefix("package ")
        remedy = f"install {package}" if package != outside else f"add --cause {outside}"
        raise RigError(f"causes.{name} is defined in {outside}, which is missing: {remedy}.")
    return _numbers(table, f"causes.{name}")


def _effect(name: str, value: Any) -> Any:
    where, kinds = f"effects.{name}", _EFFECTS[name]
    table = dict(_table(value, where))
    kind = table.pop("kind", None) if len(kinds) > 1 else next(iter(kinds))
    if str(kind) not in kinds:
        raise RigError(f"{where}.kind must be one of {', '.join(kinds)}.")
    described = kinds[kind]
    known = {f.name: f for f in fields(described)}
    for key in table:
        if key not in known:
            raise RigError(f"{where}.{key} is not a parameter: {_listed(list(known))}.")
    for key, parameter in known.items():
        if key not in table and parameter.default is MISSING:
            raise RigError(f"{where}.{key} is missing.")
    for key, found in table.items():
        for number in found if isinstance(found, list) else [found]:
            if isinstance(number, bool) or not isinstance(number, int | float):
                continue
            if not math.isfinite(number):
                raise RigError(f"{where}.{key} is {number}, which is not a finite number.")
            if number != 0.0 and not TINY <= abs(number) <= HUGE:
                raise RigError(
                    f"{where}.{key} must be 0, or from {TINY:g} to {HUGE:g} in size, not {number!r}."
                )
    try:
        return msgspec.convert(table, described)
    except msgspec.ValidationError as error:
        reason, _, at = str(error).partition(" - at `$")
        key = at.strip("`.")
        if key in table:
            hint = get_type_hints(described, include_extras=True).get(key)
            raise RigError(number_error(reason, f"{where}.{key}", table[key], hint)) from None
        raise RigError(f"{where}{at.rstrip('`')}: {reason}.") from None


def _checked_effects(effects: dict[str, Any]) -> Effects:
    try:
        return Effects(**effects)
    except ValueError as error:
        raise RigError(f"effects: {error}.") from None


def _table(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise RigError(f"{where} must be a table.")
    return value


def _numbers(value: Any, where: str) -> dict[str, float]:
    table = _table(value, where)
    for key, number in table.items():
        if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
            raise RigError(f"{where}.{key} must be a number, not {number!r}.")
    return {key: float(value) for key, value in table.items()}


def _listed(names: Sequence[str]) -> str:
    return f"the parameters are {', '.join(names)}" if names else "there are none"


def _as_text(parameters: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in parameters.items())


def _toml(name: str, values: Mapping[str, Any]) -> str:
    lines = [f"{key if key.isidentifier() else repr(key)} = {_value(v)}" for key, v in values.items()]
    return "\n".join([f"[{name}]", *lines, ""])


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list):
        return f"[{', '.join(_value(v) for v in value)}]"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(float(value))

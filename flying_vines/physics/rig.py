"""The nominal rig: the numbers of a `rig.toml`."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_type_hints

import msgspec

from flying_vines.files.toml_text import OneLineError, parsed, place, range_of, read_text
from flying_vines.physics.gas import STANDARD_PRESSURE_KPA, Gas

# Generous: a hundred times what rigs have, and more. Beyond them arithmetic overflows, or a unit is wrong.
ReservoirVolume = Annotated[float, msgspec.Meta(ge=0.001, le=1000)]
VineVolume = Annotated[float, msgspec.Meta(ge=1e-4, le=50)]
FlowResistance = Annotated[float, msgspec.Meta(ge=0.01, le=1e8)]
SupplyPressure = Annotated[float, msgspec.Meta(ge=1, le=10_000)]
Noise = Annotated[float, msgspec.Meta(ge=0, le=1000)]
Percent = Annotated[float, msgspec.Meta(ge=0, le=10_000)]
Vessel = Literal["cv", "reservoir"]
VESSELS: dict[Vessel, str] = {"cv": "control volume", "reservoir": "reservoir"}
"""What each is called."""
R = TypeVar("R")
_AIR = Gas()


class RigError(OneLineError, ValueError):
    """A rig file cannot be used; the text is one sentence for people."""


@dataclass(frozen=True)
class Reservoir:
    """The compressed-air reservoir."""

    volume_L: ReservoirVolume = 2.0


@dataclass(frozen=True)
class ControlVolume:
    """The inflated actuator. The default is the vine's."""

    volume_L: VineVolume = 0.1


@dataclass(frozen=True)
class Evp:
    """EVP, the inflation valve, fully open. Default: 20.3 SLPM at 690 kPa, from the paper's discharges."""

    flow_resistance_kPa_s_per_SL: FlowResistance = 2042.0


@dataclass(frozen=True)
class Dvp:
    """DVP, the valve that supplies the Venturi, fully open."""

    flow_resistance_kPa_s_per_SL: FlowResistance = 618.0


@dataclass(frozen=True)
class Solenoid:
    """The valve from the control volume to the vacuum port, open."""

    flow_resistance_kPa_s_per_SL: FlowResistance = 70.0


@dataclass(frozen=True)
class Venturi:
    """The vacuum pump. With DVP fully open, a supply of `rated_supply_kPa` (gauge) or more gives
    `full_vacuum_kPa`."""

    full_vacuum_kPa: Annotated[float, msgspec.Meta(ge=0, le=STANDARD_PRESSURE_KPA)] = 55.0
    rated_supply_kPa: SupplyPressure = 600.0


@dataclass(frozen=True)
class Pump:
    """A pump from ambient into the control volume, in place of reservoir and inflation valve.

    The inflation signal u drives it: Q = u · free flow · max(0, 1 − P_cv / stall pressure). The default is a
    small diaphragm pump. A supply of constant pressure behind a valve is such a pump, too: the stall pressure
    is that of the supply.
    """

    free_flow_SL_per_s: Annotated[float, msgspec.Meta(ge=1e-6, le=1000)] = 0.04
    stall_pressure_kPa: Annotated[float, msgspec.Meta(ge=0.01, le=10_000)] = 60.0

    @property
    def flow_resistance_kPa_s_per_SL(self) -> float:
        """Flow resistance of a valve that gives the same flow from a reservoir at the stall pressure."""
        return self.stall_pressure_kPa / self.free_flow_SL_per_s


@dataclass(frozen=True)
class Hose:
    """A hose between the valves and the control volume: a volume and a flow resistance.

    The default is 1 m of 4 mm tube with twice its laminar resistance.
    """

    volume_L: Annotated[float, msgspec.Meta(ge=1e-9, le=50)] = 0.0126
    flow_resistance_kPa_s_per_SL: Annotated[float, msgspec.Meta(ge=1e-6, le=1e8)] = 6.0

    def __post_init__(self) -> None:
        if not (self.volume_L > 0.0 and self.flow_resistance_kPa_s_per_SL > 0.0):
            raise ValueError("a hose's volume and resistance must be positive")


@dataclass(frozen=True)
class Sensors:
    """Standard deviations of the sensor noise."""

    cv_noise_std_kPa: Noise = 0.15
    reservoir_noise_std_kPa: Noise = 1.2


@dataclass(frozen=True)
class Rig:
    """A rig. `cv` is None if the reservoir discharges to atmosphere. With a `pump` the rig has no reservoir,
    EVP, DVP and Venturi: their numbers have no meaning.

    `tolerance_percent` has the tolerances that the file gives, by keys such as `reservoir.volume_L`. For
    other keys `tolerance` returns the default.
    """

    reservoir: Reservoir = Reservoir()
    cv: ControlVolume | None = ControlVolume()
    evp: Evp = Evp()
    dvp: Dvp = Dvp()
    solenoid: Solenoid = Solenoid()
    venturi: Venturi = Venturi()
    sensors: Sensors = Sensors()
    pump: Pump | None = None
    hose: Hose | None = None
    gas: Gas = _AIR
    tolerance_percent: dict[str, Percent] = field(default_factory=dict)

    def has(self, table: str) -> bool:
        """True if the rig has this part."""
        return getattr(self, table) is not None and not (self.pump and table in WITHOUT_PUMP)

    def tolerance(self, key: str) -> float:
        """Tolerance of the number at `key` in percent; default 1."""
        return self.tolerance_percent.get(key, 1.0)


def number(rig: Rig, key: str) -> float:
    """The number at a key such as `cv.volume_L`."""
    table, name = key.split(".")
    return float(getattr(getattr(rig, table), name))


def with_numbers(rig: Rig, numbers: Mapping[str, float]) -> Rig:
    """The rig with other numbers at keys such as `cv.volume_L`."""
    for key, value in numbers.items():
        table, name = key.split(".")
        rig = replace(rig, **{table: replace(getattr(rig, table), **{name: value})})
    return rig


def load_rig(path: Path | str) -> Rig:
    """The rig in a TOML file. A missing table has default values; without `[cv]` there is no control volume.

    RigError if the file cannot be read, or has an unknown key or an impossible number.
    """
    return read_rig(path, rig_from)


def read_rig(path: Path | str, made_of: Callable[[Mapping[str, Any]], R]) -> R:
    """The tables of a rig file, converted by `made_of`; RigErrors name the file, and the line of a key."""
    text = read_text(Path(path), RigError)
    try:
        return made_of(parsed(text, str(path), RigError))
    except RigError as error:
        if str(error).startswith(str(path)):
            raise
        # A text about a key begins with it.
        key = tuple(str(error).partition(" ")[0].rstrip(":").split("."))
        raise RigError(f"{place(text, str(path), key)}: {error}") from None


def rig_from(content: Mapping[str, Any]) -> Rig:
    """The rig in a decoded TOML file; see `load_rig`."""
    for table, value in content.items():
        if table not in _TABLES:
            raise RigError(f"unknown table {table!r} of a rig{_instead(table, _TABLES)}")
        if not isinstance(value, Mapping):
            raise RigError(f"{table} must be a table: write [{table}], and its keys on the lines below.")
    for key, value in _flat(content):
        _check_name(key)
        if isinstance(value, float) and not math.isfinite(value):
            raise RigError(f"{key} is {value}, which is not a finite number.")
    replaced = [table for table in WITHOUT_PUMP if table in content] if "pump" in content else []
    if replaced:
        raise RigError(
            f"a rig with a [pump] has no [{replaced[0]}], because the pump takes its place: "
            "remove one of the two."
        )
    if "cv" not in content and ("pump" in content or "hose" in content):
        raise RigError("a pump or a hose needs a control volume: add [cv] with its volume_L.")
    tolerances = dict(_flat(content.get("tolerance_percent", {})))
    for key, value in tolerances.items():
        try:
            msgspec.convert(value, Percent)
        except msgspec.ValidationError as error:
            raise RigError(number_error(str(error), f"tolerance_percent.{key}", value, Percent)) from None
    try:
        return msgspec.convert({"cv": None, **content, "tolerance_percent": tolerances}, Rig)
    except msgspec.ValidationError as error:
        reason, _, at = str(error).partition(" - at `$.")
        key = at.rstrip("`")
        raise RigError(number_error(reason, key, dict(_flat(content)).get(key), _hint(key))) from None


def _check_name(key: str) -> None:
    """RigError if a rig has no such key."""
    table, _, name = key.partition(".")
    choices = _MEASURED
    if table != "tolerance_percent":
        name, choices = key, tuple(known for known in _KEYS if known.startswith(f"{table}."))
    if name not in choices:
        raise RigError(f"unknown key {key!r} of a rig{_instead(name, choices)}")


def number_error(reason: str, key: str, value: object, hint: object = None) -> str:
    """Error text for a key from msgspec's "Expected `float` > 0.0" and "Expected `float`, got `str`".

    The range is that of the key's type `hint`.
    """
    if not reason.startswith("Expected `float`"):
        return f"{key}: {reason}."
    return f"{key} must be a number{range_of(hint)}, not {value!r}."


def _hint(key: str) -> object:
    """The type of the number at a key such as `cv.volume_L`."""
    table, _, name = key.partition(".")
    described = get_type_hints(Rig)[table]
    described = next((part for part in get_args(described) if part is not type(None)), described)
    return get_type_hints(described, include_extras=True).get(name)


def _instead(wrong: str, choices: Sequence[str]) -> str:
    """End of an error text: the most similar choice; all choices if none is similar or there are few."""
    near = difflib.get_close_matches(wrong, choices, n=1)
    if near and len(choices) > 2:
        return f": did you mean {near[0]}?"
    return f": use {', '.join(choices)}."


def _flat(tables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values; `a.b = 1` and `"a.b" = 1` are the same."""
    for key, value in tables.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


WITHOUT_PUMP = ("reservoir", "evp", "dvp", "venturi")
"""Tables that a rig with a pump does not have."""
_TABLES = tuple(field.name for field in fields(Rig))
_KEYS = tuple(key for key, _ in _flat(asdict(Rig(pump=Pump(), hose=Hose()))))
_MEASURED = tuple(key for key in _KEYS if not key.startswith("gas."))
"""Keys that may have a tolerance."""

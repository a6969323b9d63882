"""The catalogue of parts: one TOML file for each part, with the source of every number."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import msgspec
from msgspec import Meta

from flying_vines.config.config import ConfigError
from flying_vines.files.toml_text import converted, read_text
from flying_vines.physics import paper
from flying_vines.studies.design.robot import PartNames

Origin = Literal["printed", "computed", "assumed"]


class Number(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A number of at least 0, with its source; or assumed, with a note that gives the reason."""

    value: Annotated[float, Meta(ge=0, le=1e6)]
    source: str = ""
    assumed: bool = False
    note: str = ""

    def __post_init__(self) -> None:
        if self.assumed and self.source.strip():
            raise ValueError("has a source and assumed = true: remove one")
        if self.assumed and not self.note.strip():
            raise ValueError("an assumed number needs a note with the reason")
        if not self.assumed and not self.source.strip():
            raise ValueError("source is missing; without a source set assumed = true, with a note")

    @property
    def origin(self) -> Origin:
        """`printed` in a source, `computed` from printed numbers, or `assumed`."""
        if self.assumed:
            return "assumed"
        return "computed" if self.source.startswith("computed from") else "printed"


class PositiveNumber(Number, frozen=True, forbid_unknown_fields=True):
    """A number above 0."""

    def __post_init__(self) -> None:
        if self.value < 1e-6:
            raise ValueError("value must be above 0 (at least 1e-6)")
        super().__post_init__()


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    name: str
    mass_g: Number
    power_W: Number | None = None
    """Power while it is on."""
    note: str = ""


class ValvePart(_Part, frozen=True, tag="valve"):
    """A proportional valve: EVP (inflation valve), or DVP (supply of the Venturi)."""

    flow_SLPM: PositiveNumber
    """Flow from `at_kPa` (gauge) to atmosphere."""
    at_kPa: PositiveNumber
    max_inlet_kPa: PositiveNumber
    flow_resistance_kPa_s_per_SL: PositiveNumber | None = None
    """Minimum R_v; default: from the rated flow."""

    @property
    def resistance_kPa_s_per_SL(self) -> float:
        """R_v,min, kPa·s/SL (paper, Eq. 2)."""
        if self.flow_resistance_kPa_s_per_SL is not None:
            return self.flow_resistance_kPa_s_per_SL.value
        return paper.flow_resistance_kPa_s_per_SL(self.at_kPa.value, self.flow_SLPM.value)


class ReservoirPart(_Part, frozen=True, tag="reservoir"):
    """A vessel for compressed air; `max_kPa` is its permitted pressure (gauge), not its burst pressure."""

    volume_L: PositiveNumber
    max_kPa: PositiveNumber


class VenturiPart(_Part, frozen=True, tag="venturi"):
    """A Venturi pump."""

    consumption_SLPM: PositiveNumber
    """Consumption at `at_kPa` (gauge)."""
    at_kPa: PositiveNumber
    suction_per_consumption: PositiveNumber
    """Suction flow from atmospheric pressure, divided by the consumption."""
    max_vacuum_fraction: PositiveNumber
    """Maximum vacuum, as a share of ambient pressure."""
    full_vacuum_from_kPa: PositiveNumber
    """Below this motive pressure the vacuum falls in proportion to it."""

    @property
    def resistance_kPa_s_per_SL(self) -> float:
        """R_v of its nozzle, kPa·s/SL (paper, Eq. 2)."""
        return paper.flow_resistance_kPa_s_per_SL(self.at_kPa.value, self.consumption_SLPM.value)


class SolenoidPart(_Part, frozen=True, tag="solenoid"):
    """The binary valve out of the control volume."""

    flow_resistance_kPa_s_per_SL: PositiveNumber


class Fixed(_Part, frozen=True, tag="fixed"):
    """A part that every phloSAR needs; of each `role` the search uses the lightest."""

    role: str
    count: Annotated[int, Meta(ge=1, le=1000)] = 1


Part = ValvePart | ReservoirPart | VenturiPart | SolenoidPart | Fixed
P = TypeVar("P", ValvePart, ReservoirPart, VenturiPart, SolenoidPart, Fixed)


@dataclass(frozen=True)
class PartsChoice:
    """One choice of parts. Without `venturi` and `dvp` it vents passively."""

    evp: ValvePart
    reservoir: ReservoirPart
    solenoid: SolenoidPart
    fixed: tuple[Fixed, ...] = ()
    dvp: ValvePart | None = None
    venturi: VenturiPart | None = None
    reservoirs: int = 1

    def __post_init__(self) -> None:
        if (self.dvp is None) != (self.venturi is None):
            raise ValueError("a Venturi needs a DVP, and a DVP needs a Venturi")

    @property
    def reservoir_volume_L(self) -> float:
        return self.reservoirs * self.reservoir.volume_L.value

    def each(self) -> Iterable[tuple[Part, int]]:
        """Every part and its count."""
        yield self.evp, 1
        if self.dvp is not None and self.venturi is not None:
            yield self.dvp, 1
            yield self.venturi, 1
        yield self.solenoid, 1
        yield self.reservoir, self.reservoirs
        for part in self.fixed:
            yield part, part.count


@dataclass(frozen=True)
class Catalogue:
    """Parts by their file name without `.toml`."""

    parts: Mapping[str, Part]

    def all(self, kind: type[P]) -> list[P]:
        """Every part of a kind, sorted by name."""
        return [part for _, part in sorted(self.parts.items()) if isinstance(part, kind)]

    def fixed(self) -> tuple[Fixed, ...]:
        """The lightest part of each role."""
        lightest: dict[str, Fixed] = {}
        for part in self.all(Fixed):
            best = lightest.get(part.role)
            if best is None or part.count * part.mass_g.value < best.count * best.mass_g.value:
                lightest[part.role] = part
        return tuple(lightest.values())

    def choose(self, names: PartNames | None = None, source: str = "robot") -> PartsChoice:
        """The named parts; default: the paper's.

        Args:
            names: file names without `.toml`.
            source: name of the robot file in errors.

        Raises `ConfigError` if a name is unknown, or is a part of another kind.
        """
        names = names or PartNames()
        without = not names.venturi
        return PartsChoice(
            evp=self._get(f"{source}: parts.evp", names.evp, ValvePart),
            dvp=None if without else self._get(f"{source}: parts.dvp", names.dvp, ValvePart),
            venturi=None if without else self._get(f"{source}: parts.venturi", names.venturi, VenturiPart),
            solenoid=self._get(f"{source}: parts.solenoid", names.solenoid, SolenoidPart),
            reservoir=self._get(f"{source}: parts.reservoir", names.reservoir, ReservoirPart),
            reservoirs=names.reservoirs,
            fixed=self.fixed(),
        )

    def _get(self, key: str, name: str, kind: type[P]) -> P:
        part = self.parts.get(name)
        if isinstance(part, kind):
            return part
        of_kind = sorted(name for name, part in self.parts.items() if isinstance(part, kind))
        raise ConfigError(f"{key}: '{name}' is not in the catalogue: {', '.join(of_kind)}")


def catalogue(*folders: Path) -> Catalogue:
    """The built-in parts and those in further folders; a file replaces an earlier one of the same name.

    Raises `ConfigError` with one line that names file, line and key.
    """
    parts: dict[str, Part] = {}
    for file in resources.files("flying_vines.studies.design").joinpath("parts").iterdir():
        if file.name.endswith(".toml"):
            parts[file.name.removesuffix(".toml")] = parse(file.read_text(encoding="utf-8"), file.name)
    for folder in folders:
        if not folder.is_dir():
            raise ConfigError(f"{folder}: no such folder of parts")
        for path in sorted(folder.glob("*.toml")):
            parts[path.stem] = parse(read_text(path, ConfigError), str(path))
    return Catalogue(parts)


def parse(text: str, source: str) -> Part:
    """The part in the text of a file; `source` is its name in errors. Raises `ConfigError`."""
    part: Part = converted(text, source, Part, ConfigError)
    return part

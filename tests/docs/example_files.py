"""The files that the guides name: configurations, rigs, recorded cases, flights, missions."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from recorded_flight import TEXT, one_bend

from docs.documented_commands import ROOT
from flying_vines.config import config
from flying_vines.gateway.page_token import read_or_make
from flying_vines.physics.plant.true_rig import load_true_rig
from flying_vines.simulation.scenario import load_scenario, simulate_scenario, write_case

Maker = Callable[[Path], object]

LEAKY = "[cv]\nvolume_L = 0.1\n[causes.cv_leak]\nflow_resistance_kPa_s_per_SL = 30000\n"
SHORT = '[[runs]]\nkind = "bends"\nbend_kPa = 20.7\nhold_s = 1\nrest_s = 1\ncycles = 3\n'
PAIRS = "pressure_kPa,angle_deg\n" + "".join(
    f"{kPa},{2.6 * kPa + lag:.1f}\n"
    for lag, way in ((0.0, range(0, 22, 3)), (4.0, range(18, -1, -3)))
    for kPa in way
)
EXAMPLES = ROOT / "missions" / "examples"


def maker(word: str) -> Maker | None:
    """The function that makes the file or folder with this name."""
    for pattern, make in SHELF:
        if re.fullmatch(pattern, word):
            return make
    return None


def _text(text: str) -> Maker:
    return lambda path: path.write_text(text, encoding="utf-8")


def _copy(source: Path) -> Maker:
    return lambda path: shutil.copy(source, path)


def _beginning_of(source: Path) -> Maker:
    return lambda path: path.write_bytes(source.read_bytes()[:20_000])


def _example(path: Path) -> None:
    """An example mission, with the name that a page uses."""
    kind = "px4" if "px4" in path.name else "ardupilot"
    name = "bridge_inspection" if "bridge" in path.name else "canopy_sampling"
    end = path.suffix if path.suffix == ".toml" else f"-{kind}{path.suffix}"
    shutil.copy(EXAMPLES / f"{name}{end}", path)


@cache
def _recorded() -> Path:
    return one_bend(Path(mkdtemp(prefix="flights-")))


def _case(path: Path) -> None:
    """Recorded bends of a leaking rig."""
    path.mkdir(parents=True)
    scenario = path.parent / "scenario.toml"
    scenario.write_text(SHORT.replace('"bends"', '"bends"\nname = "run-1"'), encoding="utf-8")
    rig = path.parent / "leaky.toml"
    rig.write_text(LEAKY, encoding="utf-8")
    runs = simulate_scenario(load_true_rig(rig), load_scenario(str(scenario)))
    write_case(runs, b"[cv]\nvolume_L = 0.1\n", path)


def _flight(path: Path) -> None:
    shutil.copytree(_recorded(), path)


def _flights(path: Path) -> None:
    shutil.copytree(_recorded(), path / _recorded().name)


def _refused(path: Path) -> None:
    """A mission with an item that ArduPilot does not know."""
    text = (EXAMPLES / "canopy_sampling-ardupilot.waypoints").read_text(encoding="utf-8")
    path.write_text(text.replace("\t217\t", "\t31010\t", 1), encoding="utf-8")


SHELF: tuple[tuple[str, Maker], ...] = (
    (r"(around|vine|bench|calibrated)\.toml", _text(config.default_text())),
    (r"flown\.toml", _text(TEXT)),
    (r"wrong\.waypoints", _refused),
    (r"seam_leak\.py", _text((ROOT / "examples" / "seam_leak.py").read_text(encoding="utf-8"))),
    (r"(rig|RIG)\.toml", _text("[cv]\nvolume_L = 0.1\n")),
    (r"(leaky|extended)\.toml", _text(LEAKY)),
    (r"cases/workshop", _case),
    (r"robot\.toml", _copy(ROOT / "flying_vines/studies/design/examples/vine.toml")),
    (
        r"short\.toml",
        _text(SHORT),
    ),
    (r"(PAIRS|pairs)\.csv", _text(PAIRS)),
    (r"(plenum|first|second)\.csv", _copy(ROOT / "tests/data/measured/plenum_discharge.csv")),
    (r"mav\.tlog", _beginning_of(ROOT / "tests/data/recordings/rc_switch.tlog")),
    (r"(\w+/)?(canopy|bridge|MISSION)[\w-]*\.(toml|plan|waypoints)", _example),
    (r"token|FILE", read_or_make),
    (r"flights", _flights),
    (r"flights/[\w-]+|FLIGHT|LOG", _flight),
)
"""The first matching row counts. A name in capitals on a page stands for any file."""

"""Missions for tests, from text to the printed report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.supply import nominal
from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem
from missions.build import build
from missions.home import SIMULATOR_HOME, Home, home_of
from missions.mission import parse, planned_home
from missions.report import Report, review

EXAMPLES = Path(__file__).parents[1] / "missions" / "examples"
PX4_HOME = SIMULATOR_HOME["px4"]
KINDS: tuple[AutopilotKind, ...] = ("ardupilot", "px4")

HEAD = 'home = "simulator"\n[takeoff]\naltitude_m = 10\n'
WP, TAKEOFF, LAND, DELAY = 16, 22, 21, 93
SCRIPT, ACTUATOR, GRIPPER, WINCH, RELAY = 217, 187, 211, 42600, 181
HOME = (
    WP,
    0,
    0,
    0,
    0,
    PX4_HOME.latitude_deg,
    PX4_HOME.longitude_deg,
    PX4_HOME.altitude_amsl_m,
)


def built(text: str, kind: AutopilotKind, config: Config | None = None) -> list[MissionItem]:
    """The items of a mission's text."""
    mission = parse(text, "m.toml")
    home = planned_home(mission, kind, "m.toml")
    return build(mission, config or configuration.default(), kind, home, "m.toml", text)


def waypoint(vine: str, more: str = "north_m = 20") -> str:
    return f"[[waypoints]]\n{more}\nvine = [{vine}]\n"


def items(*entries: tuple[float, ...], frame: int = 2) -> list[MissionItem]:
    """Items of (command, param1, …). Places are near PX4's home, 10 m high, if not given."""
    made = []
    for seq, entry in enumerate(entries):
        command, *given = entry
        numbers = [float(number) for number in given]
        flown = int(command) in (WP, TAKEOFF, LAND)
        params = (*numbers, 0.0, 0.0, 0.0, 0.0)[:4] if len(numbers) <= 4 else tuple(numbers)
        if len(params) < 7:
            place = (
                PX4_HOME.latitude_deg,
                PX4_HOME.longitude_deg + 1e-4 * seq,
                10.0,
            )
            params = (*params, *(place if flown else (0.0, 0.0, 0.0)))
        p1, p2, p3, p4, x, y, z = params
        above = 0 if entry is HOME else 3
        made.append(MissionItem(seq, int(command), (p1, p2, p3, p4, x, y, z), above if flown else frame))
    return made


def reviewed(
    given: Sequence[MissionItem],
    kind: AutopilotKind,
    config: Config | None = None,
    reservoir_kPa: float = 690.0,
) -> Report:
    config = config or configuration.default()
    home = home_of(given) or Home(0.0, 0.0, 0.0)
    return review("m", given, kind, home, config, nominal(config.pneumatics), reservoir_kPa)


def finding_texts(report: Report, severity: str = "error") -> list[str]:
    """The texts of the findings."""
    return [finding.text for finding in report.findings if finding.severity == severity]

"""Reviews a mission: timeline, air budget and checks; shows them as a table, or as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table
from rich.text import Text

from flying_vines.config.config import Config
from flying_vines.supply import RigPrior
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import DELAY, SPEED, WAYPOINT, AutopilotKind, MissionItem
from missions.budget import AirBudget, FlightResult, PlannedBend, Range, budget
from missions.checks import CheckedMission, MissionFinding, check, name_of
from missions.home import Home
from missions.item_for_intent import described
from missions.timeline import Timeline, TimelineStep, timeline

WIDE = 100
"""From this terminal width on, the table has wider column gaps."""

_HEADINGS = (
    "at\ns",
    "for\ns",
    "height\nm",
    "peak\nkPa",
    "air\nkPa",
    "reservoir\nkPa",
    "90 %\nkPa",
    "cycles\nleft",
)


@dataclass(frozen=True, slots=True)
class Report:
    """A mission with timeline, budget, findings, and a simulated flight if there was one."""

    name: str
    items: Sequence[MissionItem]
    kind: AutopilotKind
    home: Home
    timeline: Timeline
    budget: AirBudget
    findings: Sequence[MissionFinding]
    flight_result: FlightResult | None = None

    @property
    def errors(self) -> list[MissionFinding]:
        return [finding for finding in self.findings if finding.severity == "error"]

    @property
    def differences(self) -> list[str]:
        """Differences between the simulated flight and the plan."""
        if self.flight_result is None:
            return []
        return list(_differences(self.budget, self.flight_result))


def review(
    name: str,
    items: Sequence[MissionItem],
    kind: AutopilotKind,
    home: Home,
    config: Config,
    prior: RigPrior,
    reservoir_kPa: float,
) -> Report:
    """Timeline, air budget and checks of the items, with the reservoir at `reservoir_kPa` (gauge)."""
    plan = timeline(items, kind, home)
    air = budget(plan, config, prior, reservoir_kPa)
    findings = check(CheckedMission(items, kind, config, plan, air))
    return Report(name, items, kind, home, plan, air, findings)


class _Row(NamedTuple):
    step: TimelineStep
    what: str
    lasts_s: float
    bend: PlannedBend | None = None


def show(report: Report, console: Console) -> None:
    """Print the mission, its budget, the simulated flight, and warnings."""
    what = f"{AUTOPILOTS[report.kind].title}, {len(report.items)} items, {report.timeline.length_s:.0f} s"
    home = f"home {report.home.latitude_deg:.7f}, {report.home.longitude_deg:.7f}"
    name = report.name or "Mission"
    console.print(Text(name, style="bold").append(f": {what}, {home}", style="not bold"))
    console.print(_table(report, console.width >= WIDE))
    console.print(_summary(report.budget))
    if report.flight_result is not None:
        console.print(_flown(report.flight_result, report.differences))
    for finding in report.findings:
        if finding.severity == "warning":
            console.print(Text(f"warning: {finding.text}", style="yellow"))


def as_json(report: Report) -> dict[str, Any]:
    """The report as JSON data; units are in the keys, pressures are gauge."""
    budget, flight = report.budget, report.flight_result
    found: dict[str, Any] = {
        "name": report.name,
        "autopilot": report.kind,
        "items": len(report.items),
        "length_s": round(report.timeline.length_s, 2),
        "steps": [_row_as_json(row) for row in _rows(report.timeline, budget)],
        "reservoir_kPa": _range(budget.begins),
        "reservoir_end_kPa": _range(budget.ends),
        "findings": [
            {"severity": finding.severity, "item": finding.seq, "text": finding.text}
            for finding in report.findings
        ],
    }
    if flight is not None:
        found["trial"] = {
            "items": [item.seq for item in flight.ran],
            "decisions": [
                {"item": d.what.get("seq"), "intent": d.intent, "safety": d.safety, "reason": d.reason}
                for d in flight.decisions
            ],
            "reservoir_kPa": round(flight.begins_kPa, 2),
            "reservoir_end_kPa": round(flight.ends_kPa, 2),
            "length_s": flight.length_s,
            "landed": flight.landed,
            "differences": report.differences,
        }
    return found


def _rows(timeline: Timeline, budget: AirBudget) -> Iterator[_Row]:
    """One row per step. A wait after a vine item belongs to the item's row."""
    bends = {(bend.step.t_s, bend.step.item.seq): bend for bend in budget.bends}
    steps = list(timeline.steps)
    before: PlannedBend | None = None
    for i, step in enumerate(steps):
        bend = bends.get((step.t_s, step.item.seq))
        previous, before = before, bend
        if previous is not None and step.item.command == DELAY:
            continue
        if bend is None:
            yield _Row(step, _flight(step), step.takes_s)
            continue
        after = steps[i + 1] if i + 1 < len(steps) else None
        holds = after is not None and after.item.command == DELAY
        yield _Row(step, f"  {_vine(bend)}", after.takes_s if after and holds else 0.0, bend)


def _flight(step: TimelineStep) -> str:
    name = f"waypoint {step.waypoint}" if step.item.command == WAYPOINT else name_of(step.item)
    if step.item.command == SPEED:
        name = f"speed {step.item.params[1]:g} m/s"
    return f"{name}, {step.distance_m:.0f} m" if step.distance_m else name


def _vine(bend: PlannedBend) -> str:
    return str(bend.intent) if bend.intent else described(bend.step.item)


def _table(report: Report, wide: bool) -> Table:
    table = Table(box=None, padding=(0, 2 if wide else 1), pad_edge=False, header_style="bold")
    table.add_column("item", justify="right", no_wrap=True)
    table.add_column("what", overflow="fold")
    for heading in _HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in _rows(report.timeline, report.budget):
        table.add_row(str(row.step.item.seq), row.what, *_cells(row), style="" if row.bend else "dim")
    return table


def _cells(row: _Row) -> Iterator[str | Text]:
    bend = row.bend
    yield f"{row.step.t_s:.0f}"
    yield f"{row.lasts_s:.1f}" if row.lasts_s else ""
    yield f"{row.step.height_m:.0f}"
    if bend is None:
        return
    if bend.ruling.verdict == "refused" or bend.motion is None:
        yield from ("", "", Text("refused", style="red"))
        return
    yield f"{bend.motion.top_kPa:.1f}"
    yield f"{bend.air_kPa:.1f}"
    yield f"{bend.before.expected:.0f} → {bend.after.expected:.0f}"
    yield f"{bend.after.low:.0f}…{bend.after.high:.0f}"
    yield f"{bend.cycles.expected:.0f}" if bend.cycles else ""


def _summary(budget: AirBudget) -> Text:
    begins, ends = budget.begins, budget.ends
    text = f"Reservoir {begins.expected:.0f} → {ends.expected:.0f} kPa gauge ({ends.low:.0f}…{ends.high:.0f})"
    cycles = budget.bends[-1].cycles if budget.bends else None
    if cycles is not None:
        text += f"; {cycles.expected:.0f} cycles left ({cycles.low:.0f}…{cycles.high:.0f})"
    return Text(text + ".")


def _flown(flight: FlightResult, differences: Sequence[str]) -> Text:
    air = f"reservoir {flight.begins_kPa:.0f} → {flight.ends_kPa:.0f} kPa"
    text = f"Flown in simulation: {len(flight.decisions)} vine items in {flight.length_s:.0f} s, {air}"
    text += f"; {flight.speed:.0f} times real time."
    if not differences:
        return Text(text + " As planned.", style="green")
    return Text("\n".join([text, *(f"not as planned: {each}" for each in differences)]), style="yellow")


def _differences(budget: AirBudget, flight: FlightResult) -> Iterator[str]:
    planned = [bend.step.item.seq for bend in budget.bends]
    ran = [item.seq for item in flight.ran]
    if ran != planned:
        yield f"items {ran} ran, not {planned}"
    decided = [decision.what.get("seq") for decision in flight.decisions]
    if decided != planned:
        yield f"the service decided about items {decided}, not {planned}"
    for bend, decision in zip(budget.bends, flight.decisions, strict=False):
        refused = bend.ruling.verdict == "refused", decision.safety == "refused"
        if refused[0] != refused[1]:
            yield f"item {bend.step.item.seq} was {decision.safety}, not {bend.ruling.verdict}"
    spent = flight.begins_kPa - flight.ends_kPa
    least, most = budget.begins.low - budget.ends.high, budget.begins.high - budget.ends.low
    if not least <= spent <= most:
        yield f"the reservoir lost {spent:.1f} kPa, not {max(0.0, least):.1f}…{most:.1f}"
    if not flight.landed:
        yield f"the vehicle had not landed after {flight.length_s:.0f} s"


def _row_as_json(row: _Row) -> dict[str, Any]:
    step, bend = row.step, row.bend
    found: dict[str, Any] = {
        "item": step.item.seq,
        "what": row.what.strip(),
        "waypoint": step.waypoint,
        "at_s": round(step.t_s, 2),
        "for_s": round(row.lasts_s, 2),
        "height_m": round(step.height_m, 2),
        "distance_m": round(step.distance_m, 2),
    }
    if bend is not None:
        cycles = bend.cycles
        found["vine"] = {
            "intent": str(bend.intent) if bend.intent else None,
            "safety": bend.ruling.verdict,
            "reason": bend.ruling.reason or bend.doubt,
            "peak_kPa": round(bend.motion.top_kPa, 3) if bend.motion else None,
            "air_kPa": round(bend.air_kPa, 3),
            "before_kPa": _range(bend.before),
            "after_kPa": _range(bend.after),
            "cycles_left": [round(n, 1) for n in (cycles.expected, cycles.low, cycles.high)]
            if cycles
            else None,
        }
    return found


def _range(pressures: Range) -> list[float]:
    return [round(value, 2) for value in pressures]

"""The result of the design guide on a terminal, and as plain data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from flying_vines.studies.design.evaluate import DEFLATED, Evaluation, Performance
from flying_vines.studies.design.parts import PartsChoice

WHAT: Mapping[Performance, str] = {
    "cycles": "cycles",
    "inflation": "inflation speed",
    "deflation": "deflation speed",
}


def show(
    evaluation: Evaluation,
    fronts: Mapping[Performance, Sequence[Evaluation]],
    tried: Sequence[Evaluation],
    console: Console,
) -> None:
    """Print the robot's table and the fronts."""
    console.print(Text(evaluation.robot.name, style="bold"))
    console.print(Text(words(evaluation.parts)))
    console.print()
    console.print(_table(evaluation))
    short = evaluation.shortfalls
    console.print(
        Text(f"Does not meet: {'; '.join(short)}.", style="red")
        if short
        else Text("Meets all requirements of the robot.", style="green")
    )
    for note in notes(evaluation):
        console.print(Text(f"· {note}"))
    for by, found in fronts.items():
        console.print()
        console.print(
            Text(f"Pareto front of mass and {WHAT[by]}: {len(found)} of {len(tried)} choices", style="bold")
        )
        if found:
            console.print(_front(found))
        else:
            counts = Counter(name for e in tried for name in e.missed)
            missed = ", ".join(f"{name} by {count}" for name, count in counts.most_common())
            console.print(
                Text(f"No choice of the catalogue meets all requirements. Missed: {missed}.", style="red")
            )


def words(parts: PartsChoice) -> str:
    """A choice in one line."""
    count = f"{parts.reservoirs} × " if parts.reservoirs > 1 else ""
    pump = (
        f"{parts.venturi.name} behind {parts.dvp.name}" if parts.venturi and parts.dvp else "passive venting"
    )
    return f"{parts.evp.name} · {pump} · {count}{parts.reservoir.name}"


def notes(evaluation: Evaluation) -> list[str]:
    """Remarks on the numbers."""
    robot, e = evaluation.robot, evaluation
    found = []
    if e.fill_kPa < robot.fill_kPa:
        found.append(f"The parts permit a fill of {e.fill_kPa:.0f} kPa, not {robot.fill_kPa:.0f} kPa.")
    if e.least_kPa < 3.0 * robot.pressure_kPa:
        found.append(
            "Eq. 4 and 8 assume P_r ≫ P_cv, but the minimum P_r is "
            f"{e.least_kPa / robot.pressure_kPa:.1f} P_cv: the last cycles will be slower."
        )
    min_kPa = e.least_for_deflation_kPa
    if min_kPa is not None and min_kPa > e.least_kPa:
        found.append(
            f"Below {min_kPa:.0f} kPa deflation is slower than wanted; Eq. 8 counts cycles down to "
            f"{e.least_kPa:.0f} kPa."
        )
    if e.parts.venturi is not None and e.passive_is_enough:
        found.append("The solenoid alone is fast enough (its R_v is assumed): the Venturi only adds speed.")
    shares = e.mass_by_origin_kg
    if shares["computed"] + shares["assumed"] > 0.0:
        found.append(
            f"Mass: {shares['printed']:.3f} kg has a printed source, {shares['computed']:.3f} kg is "
            f"computed, {shares['assumed']:.3f} kg is assumed."
        )
    coils = [part.power_W for part, _ in e.parts.each() if part.power_W is not None]
    if any(power.assumed for power in coils):
        found.append("The power includes assumed powers; no data sheet was available.")
    return found


def rows(evaluation: Evaluation) -> list[tuple[str, str, float, float | None, str]]:
    """Quantity, unit, value, wanted value or None, and source."""
    e, robot = evaluation, evaluation.robot
    kind = f"{robot.cv_kind} {robot.cv_volume_L:g} L"
    wanted: dict[str, float | None] = dict.fromkeys(("rigid", "pouch", "passive"))
    # The cycles that count for this robot on these parts.
    wanted["passive" if e.parts.venturi is None else robot.cv_kind] = robot.least_cycles or None
    up, down = robot.wanted_inflation_kPa_per_s, robot.wanted_deflation_kPa_per_s
    left = f"to {100 * DEFLATED:.0f} % left, not in the paper"
    swing = f"Eq. 7, {robot.swing_kPa:g} kPa peak to peak"
    return [
        ("filled to", "kPa", e.fill_kPa, None, "robot, or limit of the parts"),
        ("inflation speed", "kPa/s", e.inflation_kPa_per_s, up, f"Eq. 4, {kind}"),
        ("deflation speed", "kPa/s", e.deflation_kPa_per_s, down, left),
        ("deflation speed, passive", "kPa/s", e.passive_kPa_per_s, None, "same, solenoid alone"),
        ("bandwidth", "Hz", e.bandwidth_Hz, robot.frequency_Hz, swing),
        ("min. reservoir pressure", "kPa", e.least_kPa, None, "Eq. 4, wanted inflation"),
        ("cycles, rigid", "", e.cycles_rigid, wanted["rigid"], "Eq. 8"),
        ("cycles, pouch's air", "", e.cycles_pouch_air, None, "Eq. 8, air of V (P_a + P)"),
        (
            "cycles, pouch, fast enough",
            "",
            e.cycles_pouch,
            wanted["pouch"],
            "Eq. 8, minimum P_r of a pouch",
        ),
        ("cycles, passive venting", "", e.cycles_passive, wanted["passive"], "no air for the Venturi"),
        ("operating time, cycling", "s", e.operating_s, None, f"{robot.cycle_rate_Hz:.3g} cycles a second"),
        ("operating time, fully open", "s", e.full_open_s, None, "Eq. 3 to minimum pressure"),
        ("mass", "kg", e.mass_kg, None, "of the parts"),
        ("mass with the robot", "kg", e.total_kg, robot.payload_kg, f"plus {robot.other_mass_kg:g} kg"),
        ("power, mean", "W", e.power_W, None, "valves on; the paper: 3 W"),
    ]


def _table(evaluation: Evaluation) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False)
    table.add_column("quantity", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for heading in ("value", "wanted"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("by", overflow="fold")
    for quantity, unit, value, wanted, by in rows(evaluation):
        sign = "≤" if quantity.startswith("mass") else "≥"
        limit = "" if wanted is None else f"{sign} {_number(wanted)}"
        table.add_row(quantity, unit, _number(value), limit, Text(by))
    return table


def _front(found: Sequence[Evaluation]) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False)
    for heading in ("kg", "cycles", "up kPa/s", "down kPa/s"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("parts", overflow="fold")
    for e in found:
        table.add_row(
            f"{e.mass_kg:.2f}",
            f"{e.cycles:.0f}",
            _number(e.inflation_kPa_per_s),
            _number(e.deflation_kPa_per_s),
            Text(words(e.parts)),
        )
    return table


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


NUMBERS = (
    "fill_kPa", "inflation_kPa_per_s", "deflation_kPa_per_s", "passive_kPa_per_s", "bandwidth_Hz",
    "least_kPa", "cycles", "cycles_rigid", "cycles_pouch_air", "cycles_pouch", "cycles_passive",
    "operating_s", "full_open_s", "mass_kg", "mass_by_origin_kg", "power_W",
)  # fmt: skip
CURVES = (
    "reservoir_kPa", "inflation_curve_kPa_per_s", "deflation_curve_kPa_per_s", "bandwidth_curve_Hz",
)  # fmt: skip


def as_json(evaluation: Evaluation, fronts: Mapping[Performance, Sequence[Evaluation]]) -> dict[str, Any]:
    """Everything as plain lists, numbers and texts; the keys are described in docs/design.md."""
    curves = {name: getattr(evaluation, name).tolist() for name in CURVES}
    return {
        "evaluation": {**_plain(evaluation), **curves},
        "robot": msgspec.to_builtins(evaluation.robot),
        "notes": notes(evaluation),
        "fronts": {by: [_plain(e) for e in found] for by, found in fronts.items()},
    }


def _plain(e: Evaluation) -> dict[str, Any]:
    return {
        "parts": [{"name": part.name, "count": count} for part, count in e.parts.each()],
        "shortfalls": list(e.shortfalls),
        **{name: getattr(e, name) for name in NUMBERS},
    }

"""A flight as a picture: setpoint and pressure, bend angle, openings, reservoir, decisions.

EVP: inflation valve. DVP: valve that supplies the Venturi.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from textwrap import shorten
from typing import Any

from matplotlib import pyplot as plt

from flying_vines.core.events import carried_out_unrequested
from flying_vines.plots.style import BLUE, GREEN, GREY, LABEL_BOX, ORANGE, PURPLE, RED, plain
from flying_vines.plots.vine import draw_drone, draw_vine, frame
from flying_vines.record.reader import FlightLog, LogError
from flying_vines.record.topics import DECISION, SNAPSHOT, TELEMETRY

MARKS = {"accepted": GREEN, "limited": ORANGE, "refused": RED}
ROW, MAX_ROWS = 0.13, 5
"""Height of a row of labels, as a share of the pressure axis, and the maximum number of rows."""
MAX_REASON = 44
"""Maximum length of the reason in a label. A longer reason is cut between words."""
DPI = 200
MAX_POINTS = 20_000
"""Maximum number of telemetry points in a curve. A picture shows fewer, and a vector file stays small."""
DRAWN_LENGTH_M, DRAWN_DIAMETER_M = 0.315, 0.05
"""A log does not have the vine's size. So the size of a usual one is drawn."""
DRAWN_WIDTH = 0.085
"""Width of a drawn vine, as a share of the picture."""
MIN_CHANGE_DEG = 3.0
"""The vine is drawn again only if its angle has changed by at least this."""
SETTLED = 5
"""The drawn angle is the median of this many snapshots."""


def draw_flight(log: FlightLog, path: Path, title: str | None = None) -> None:
    """Draw a flight: pressures, bend angle, openings, reservoir, triggers over time.

    The suffix of `path` selects the format: PNG, PDF or SVG. Raises `LogError` if there is nothing to draw.
    """
    messages: dict[str, list[dict[str, Any]]] = {SNAPSHOT: [], DECISION: [], TELEMETRY: []}
    began_ns = 0
    for entry in log.entries(messages):
        began_ns = began_ns or entry.unix_ns
        messages[entry.topic].append(entry.fields)
    snapshots, decisions, telemetry = messages.values()
    if len(snapshots) < 2:
        raise LogError(f"{log.path}: has no snapshots to draw")
    start = snapshots[0]["t"]
    slow = _Columns(snapshots, start)
    quick = _Columns(telemetry[:: 1 + len(telemetry) // MAX_POINTS], start)

    figure, axes = plt.subplots(
        5, 1, figsize=(12, 11), sharex=True, height_ratios=[3.2, 1.5, 1.6, 1.4, 1.8], layout="constrained"
    )
    pressure, shape, bend, opening, reservoir = axes
    when = time.strftime("%Y-%m-%d, %H:%M:%S", time.localtime(began_ns / 1e9))
    figure.align_ylabels(axes)
    figure.suptitle(title or f"Flight of {when}", x=0.01, ha="left", fontweight="bold")
    _draw_pressure(pressure, slow, quick, decisions, start)
    _draw_vines(shape, slow.t, slow["bend_deg"], [d["t"] - start for d in decisions])
    bend.plot(slow.t, slow["bend_deg"], color=PURPLE, lw=1.3)
    bend.set_ylabel("bend, °")
    bend.set_ylim(bottom=-2)
    _draw_openings(opening, quick)
    _draw_reservoir(reservoir, slow.t, snapshots, quick)
    for axis in axes:
        _shade_safe_states(axis, slow.t, snapshots)
        plain(axis)
        axis.set_xlim(slow.t[0], slow.t[-1])
    shape.set_axis_off()
    with plt.rc_context({"pdf.fonttype": 42, "svg.fonttype": "none"}):  # keep text as text, not as outlines
        figure.savefig(path, dpi=DPI)
    plt.close(figure)


class _Columns:
    """The columns of a topic's entries; NaN for an unknown value."""

    def __init__(self, entries: Sequence[dict[str, Any]], start: float) -> None:
        self.t = [entry["t"] - start for entry in entries]
        self._entries = entries

    def __getitem__(self, name: str) -> list[float]:
        return [entry.get(name, math.nan) for entry in self._entries]


def _draw_pressure(
    axis: Any, slow: _Columns, quick: _Columns, decisions: list[dict[str, Any]], start: float
) -> None:
    axis.plot(slow.t, slow["command_kPa"], color=ORANGE, lw=1.6, label="setpoint")
    axis.plot(quick.t, quick["cv_kPa"], color=BLUE, lw=1.1, label="vine (CV)")
    axis.set_ylabel("pressure, kPa gauge")
    top = max(25.0, 1.1 * max((x for x in quick["cv_kPa"] if x == x), default=0.0))
    axis.set_yticks(range(0, int(top) + 1, 5))
    axis.legend(loc="upper right", ncols=2, frameon=False)
    _mark_decisions(axis, decisions, start, slow.t[-1], top)


def _draw_openings(axis: Any, quick: _Columns) -> None:
    axis.fill_between(quick.t, quick["evp_opening"], color=BLUE, alpha=0.6, lw=0, step="post")
    downwards = [-x for x in quick["dvp_opening"]]
    axis.fill_between(quick.t, downwards, color=GREEN, alpha=0.7, lw=0, step="post")
    solenoid = [-1.25 if is_open else math.nan for is_open in quick["solenoid"]]
    axis.plot(quick.t, solenoid, color=GREY, lw=4, solid_capstyle="butt")
    axis.set_ylim(-1.5, 1.1)
    axis.set_yticks([-1.25, -0.5, 0.5], ["solenoid", "DVP", "EVP"])
    axis.set_ylabel("openings")


def _draw_reservoir(axis: Any, t: list[float], snapshots: list[dict[str, Any]], quick: _Columns) -> None:
    axis.plot(quick.t, quick["reservoir_kPa"], color=BLUE, lw=1.1)
    axis.set_ylabel("reservoir,\nkPa gauge", color=BLUE)
    axis.set_ylim(bottom=0)
    axis.set_xlabel("time, s")
    cycles = axis.twinx()
    known = [(x, s["cycles"]) for x, s in zip(t, snapshots, strict=True) if s.get("cycles")]
    if known:
        xs = [x for x, _ in known]
        cycles.fill_between(
            xs, [c["low"] for _, c in known], [c["high"] for _, c in known], color=PURPLE, alpha=0.15, lw=0
        )
        cycles.plot(xs, [c["expected"] for _, c in known], color=PURPLE, lw=1.3)
    cycles.set_ylabel("cycles left, 90 % interval", color=PURPLE)
    cycles.set_ylim(bottom=0)
    cycles.spines["top"].set_visible(False)


def _draw_vines(axis: Any, t: list[float], bend_deg: list[float], decided: list[float]) -> None:
    """Draw the vine as it was just before each decision, and at the end of the flight."""
    width = max(t[-1] - t[0], 1e-9)
    drawn: list[tuple[float, float]] = []
    for moment in (*decided, t[-1]):
        known = [deg for x, deg in zip(t, bend_deg, strict=True) if x < moment and deg == deg]
        settled = median(known[-SETTLED:]) if known else math.nan
        if known and not (drawn and abs(settled - drawn[-1][1]) < MIN_CHANGE_DEG):
            drawn.append(((moment - t[0]) / width, settled))
    drawn = drawn[:: 1 + int(len(drawn) * DRAWN_WIDTH)]
    for (moment, deg), place in zip(drawn, _side_by_side([x for x, _ in drawn]), strict=True):
        glyph = axis.inset_axes((place - 0.5 * DRAWN_WIDTH, 0.08, DRAWN_WIDTH, 0.92))
        draw_drone(glyph)
        tip = draw_vine(glyph, deg, DRAWN_LENGTH_M, DRAWN_DIAMETER_M, PURPLE)
        glyph.annotate(
            f"{deg:.0f}°", tip, xytext=(9, -4), textcoords="offset points", color=PURPLE, fontsize=7.5
        )
        frame(glyph, DRAWN_LENGTH_M, DRAWN_DIAMETER_M)
        axis.plot([place, moment], [0.2, 0.0], transform=axis.transAxes, color=PURPLE, lw=0.7, alpha=0.6)


def _side_by_side(wanted: list[float]) -> list[float]:
    """Positions near the wanted ones, without overlap, 0…1."""
    places: list[float] = []
    for x in wanted:
        places.append(max(x, places[-1] + DRAWN_WIDTH if places else 0.5 * DRAWN_WIDTH))
    room = 1.0 - 0.5 * DRAWN_WIDTH
    for i in reversed(range(len(places))):
        places[i] = min(places[i], room)
        room = places[i] - DRAWN_WIDTH
    return places


def _mark_decisions(
    axis: Any, decisions: list[dict[str, Any]], start: float, width: float, top: float
) -> None:
    """Label each decision, and make room for the labels above the curves."""
    rows: list[float] = []
    for decision in decisions:
        x = decision["t"] - start
        unrequested = carried_out_unrequested(decision["trigger"], decision["safety"])
        color = ORANGE if unrequested else MARKS[decision["safety"]]
        # Each label goes to the lowest row with room for it.
        text = f"{decision['trigger'].replace('_', ' ')}: {decision.get('intent', '?')}"
        if decision["safety"] != "accepted" or decision["trigger"] == "failsafe":
            text += "\n" + shorten(decision["reason"], MAX_REASON, placeholder=" …")
        longest = max(len(line) for line in text.split("\n"))
        row = next((i for i, end in enumerate(rows) if end < x), len(rows))
        rows[row : row + 1] = [x + width * 0.0068 * longest]
        y = top * (1.05 + ROW * (row % MAX_ROWS))
        axis.plot([x, x], [-1.0, y], color=color, lw=0.9, alpha=0.8)
        axis.text(
            x + width * 0.003,
            y,
            text,
            fontsize=7.5,
            color=color,
            va="bottom",
            linespacing=0.95,
            bbox=LABEL_BOX,
        )
    axis.set_ylim(-1.0, top * (1.2 + ROW * min(len(rows), MAX_ROWS)))


def _shade_safe_states(axis: Any, t: list[float], snapshots: list[dict[str, Any]]) -> None:
    begin: float | None = None
    for x, snapshot in zip(t, snapshots, strict=True):
        if snapshot["safe_state"] and begin is None:
            begin = x
        elif not snapshot["safe_state"] and begin is not None:
            axis.axvspan(begin, x, color=RED, alpha=0.08, lw=0)
            begin = None
    if begin is not None:
        axis.axvspan(begin, t[-1], color=RED, alpha=0.08, lw=0)

"""Searches all choices of a catalogue for the Pareto front of mass and performance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

from flying_vines.studies.design.evaluate import Evaluation, evaluate
from flying_vines.studies.design.parts import (
    Catalogue,
    PartsChoice,
    ReservoirPart,
    SolenoidPart,
    ValvePart,
    VenturiPart,
)
from flying_vines.studies.design.robot import Robot

Performance = Literal["cycles", "inflation", "deflation"]

MAX_RESERVOIRS = 2
"""Maximum number of equal reservoirs in parallel."""


def choices(catalogue: Catalogue) -> Iterator[PartsChoice]:
    """Every choice of valves, Venturi (or none), solenoid and reservoirs, with the lightest fixed parts."""
    fixed = catalogue.fixed()
    valves = catalogue.all(ValvePart)
    pumps: list[tuple[ValvePart | None, VenturiPart | None]] = [(None, None)]
    pumps += [(dvp, venturi) for dvp in valves for venturi in catalogue.all(VenturiPart)]
    for evp in valves:
        for dvp, venturi in pumps:
            for solenoid in catalogue.all(SolenoidPart):
                for reservoir in catalogue.all(ReservoirPart):
                    for count in range(1, MAX_RESERVOIRS + 1):
                        yield PartsChoice(evp, reservoir, solenoid, fixed, dvp, venturi, count)


def evaluate_all(robot: Robot, catalogue: Catalogue) -> list[Evaluation]:
    """Evaluations of all choices, including those that miss a requirement."""
    return [evaluate(robot, parts) for parts in choices(catalogue)]


def performance(evaluation: Evaluation, by: Performance) -> float:
    """The performance: cycles, or kPa/s from a full reservoir."""
    if by == "cycles":
        return evaluation.cycles
    return evaluation.inflation_kPa_per_s if by == "inflation" else evaluation.deflation_kPa_per_s


def front(evaluations: Sequence[Evaluation], by: Performance = "cycles") -> list[Evaluation]:
    """The Pareto front among the evaluations that meet all requirements, lightest first.

    Of equal evaluations only the first is in it.
    """
    meeting = [evaluation for evaluation in evaluations if not evaluation.shortfalls]
    meeting.sort(key=lambda evaluation: (evaluation.mass_kg, -performance(evaluation, by)))
    found: list[Evaluation] = []
    for evaluation in meeting:
        if not found or performance(evaluation, by) > performance(found[-1], by):
            found.append(evaluation)
    return found


def search(robot: Robot, catalogue: Catalogue, by: Performance = "cycles") -> list[Evaluation]:
    """The Pareto front of mass and performance among the choices that meet a robot's requirements.

    Empty if no choice meets them; then see `Evaluation.shortfalls` of `evaluate_all`.
    """
    return front(evaluate_all(robot, catalogue), by)

"""Compares the verdicts of `diagnose` about measured rigs of other laboratories with independent fits.

    python benchmarks/measured.py                        # every recording and folder of tests/data/measured
    python benchmarks/measured.py --only plenum_discharge

Each recording goes through the project's importer, with the answers to its questions from the file beside the
recording, and through `diagnose`. `measured_fits.py` fits the same readings with equations of its own. The
truth about these rigs is unknown. If both find the same number for the same law, both are probably right; the
residual shows how well the law describes the rig. The leaking chambers are three rigs, so their folder is not
also one case. Needs pip install 'flying-vines[analysis]'.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from measured_fits import Array, Fitted, Readings, discharge, leak, pump
from rich import box
from rich.console import Console
from rich.table import Table

from flying_vines.identification.case import Case, read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.importing.answers_file import answers_path, read_answers
from flying_vines.identification.importing.runs import Proposal, answers_of_similar, propose, write_case
from flying_vines.identification.verdict import NONE, UNEXPLAINED, Verdict

DATA = Path(__file__).parents[1] / "tests" / "data" / "measured"
GROUPS = ("leaking_chambers", "plenum_discharge", "pump_and_chamber")
ONE_RIG = {
    "plenum_discharge": "*.csv",
    "pump_and_chamber": "sweep_kp_*.csv",
}
"""Recordings of one rig, which are also one case together."""

POSSIBLE: Mapping[str, tuple[float, float]] = {
    "flow_resistance_kPa_s_per_SL": (0.0, float("inf")),
    "conductance_constant_kPa2_s_per_SL": (0.0, float("inf")),
    "critical_pressure_ratio": (0.0, 0.6),
    "time_constant_s": (0.0, 120.0),
    "delay_s": (0.0, 1.0),
    "per_kPa": (0.0, 0.1),
    "volume_L": (0.0, 1.0),
    "scale": (0.3, 3.0),
    "gain": (0.8, 1.25),
    "offset_kPa": (-25.0, 25.0),
    "opening": (0.0, 0.8),
    "width": (0.0, 0.5),
    "rate_kPa_per_s": (-0.002, 0.002),
    "supply_pressure_kPa": (0.0, 1000.0),
}
"""Possible values in a laboratory. Nozzles choke at 0.55 or below, the ambient pressure of a room is
constant, and a sensor is not off by more than the total error of its data sheet."""


@dataclass(frozen=True, eq=False)
class Looked:
    """A case, its verdict, and the independent fits, the best first."""

    name: str
    case: Case
    said: dict[str, Any]
    rms_kPa: tuple[float, float]
    """Residuals of the measured pressure: with the baseline, and with the causes."""
    fits: list[Fitted]
    seconds: float


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=GROUPS, action="append", help="one folder; may be repeated")
    arguments = parser.parse_args(argv)
    console = Console(highlight=False, soft_wrap=True, width=400)
    looked = []
    for name, files in cases(arguments.only or GROUPS):
        looked.append(look(name, files))
        print(f"{name}: {looked[-1].said['cause']}", file=sys.stderr, flush=True)
    show(looked, console)
    return 0


def cases(groups: Sequence[str]) -> Iterator[tuple[str, list[Path]]]:
    """Every recording alone, then the recordings of one rig together."""
    for group in groups:
        for path in sorted((DATA / group).glob("*.csv")):
            yield f"{group}/{path.stem}", [path]
        if group in ONE_RIG:
            yield group, sorted((DATA / group).glob(ONE_RIG[group]))


def imported(files: Sequence[Path], folder: Path) -> Case:
    """The imported case, with the answers stored beside each file, or beside a file with the same columns."""
    proposals: list[Proposal] = []
    answered = [path for path in sorted(files[0].parent.glob("*.csv")) if answers_path(path).exists()]
    for path in files:
        kept = answers_path(path)
        if kept.exists():
            said = read_answers(kept)
        else:
            alike = [
                answers_of_similar(path, propose(one, read_answers(answers_path(one)))) for one in answered
            ]
            said = next(answers for answers in alike if answers.columns)
        proposals.append(propose(path, said))
    write_case(proposals, folder)
    return read_case(folder)


def look(name: str, files: Sequence[Path]) -> Looked:
    """Import, diagnose, and fit independently."""
    with tempfile.TemporaryDirectory() as folder:
        case = imported(files, Path(folder) / "case")
        began_s = time.perf_counter()
        verdict = diagnose(case)
        seconds = time.perf_counter() - began_s
    return Looked(name, case, verdict.as_json(), rms(verdict), fits_of(name)(case), seconds)


def rms(verdict: Verdict) -> tuple[float, float]:
    """Root mean squares of measured minus simulated pressure, kPa, over all runs and channels."""
    baseline, extended = [], []
    for run in verdict.evidence.runs:
        for measured, before, after in zip(run.measured_kPa, run.baseline_kPa, run.extended_kPa, strict=True):
            there = np.isfinite(measured)
            baseline.append((measured - before)[there])
            extended.append((measured - after)[there])
    squares = [float(np.mean(np.concatenate(parts) ** 2)) for parts in (baseline, extended)]
    return squares[0] ** 0.5, squares[1] ** 0.5


def fits_of(name: str) -> Callable[[Case], list[Fitted]]:
    """The independent fits of a group."""
    return {
        "leaking_chambers": _leak_fits,
        "plenum_discharge": _discharge_fits,
        "pump_and_chamber": _pump_fits,
    }[name.partition("/")[0]]


def _leak_fits(case: Case) -> list[Fitted]:
    (run,) = readings(case)
    return leak(run, case.rig.reservoir.volume_L)


def _discharge_fits(case: Case) -> list[Fitted]:
    runs, volume_L = readings(case), case.rig.reservoir.volume_L
    fits = [discharge(runs, volume_L, cold_flow=cold) for cold in (False, True)]
    return sorted(fits, key=lambda one: one.rms_kPa)


def _pump_fits(case: Case) -> list[Fitted]:
    assert case.rig.cv is not None
    return [pump(readings(case), case.rig.cv.volume_L)]


def readings(case: Case) -> list[Readings]:
    """The readings of the only measured pressure."""
    runs = []
    for run in case.runs:
        pressure: Array = run.reservoir_kPa if case.rig.cv is None else run.cv_kPa
        there = np.isfinite(pressure)
        runs.append(Readings(run.time_s[there], pressure[there], run.evp_opening[there]))
    return runs


def named(said: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The causes with their parameters and shares, the main cause first; for `unexplained`, those of the best
    fit."""
    if said["cause"] == UNEXPLAINED:
        tried = said["ranking"][0]["parameters"] if said.get("ranking") else {}
        return [{"cause": cause, "parameters": parameters} for cause, parameters in tried.items()]
    first = [] if said["cause"] == NONE else [said]
    return [*first, *said.get("also", ())]


def impossible(said: Mapping[str, Any]) -> list[str]:
    """Parameters whose whole interval is impossible in a room, and intervals that are not valid."""
    found = []
    for one in named(said):
        for name, value in one.get("parameters", {}).items():
            low, high = POSSIBLE.get(name, (-float("inf"), float("inf")))
            ordered = value["low"] <= value["estimate"] <= value["high"]
            overlaps = value["low"] <= high and value["high"] >= low
            if not (overlaps and isfinite(value["estimate"]) and ordered):
                found.append(f"{one['cause']} {name} {value['estimate']:.4g}")
    return found


# For each cause and parameter: the independent law and parameter that mean the same number.
SAME = {
    ("reservoir_leak", "flow_resistance_kPa_s_per_SL"): ("ohm", "flow_resistance_kPa_s_per_SL"),
    ("reservoir_viscous_leak", "conductance_constant_kPa2_s_per_SL"): (
        "viscous",
        "conductance_constant_kPa2_s_per_SL",
    ),
    ("compressible_flow", "critical_pressure_ratio"): ("choked, cooling", "critical_pressure_ratio"),
    ("reservoir_cooling", "time_constant_s"): ("choked, cooling", "time_constant_s"),
    ("reservoir_sensor_offset", "offset_kPa"): ("choked, cooling", "offset_kPa"),
    ("cv_leak", "flow_resistance_kPa_s_per_SL"): ("pump, leak, lag", "flow_resistance_kPa_s_per_SL"),
    ("evp_lag", "time_constant_s"): ("pump, leak, lag", "time_constant_s"),
    ("evp_dead_zone", "opening"): ("pump, leak, lag", "opening"),
}


def compared(said: Mapping[str, Any], fits: Sequence[Fitted]) -> Iterator[str]:
    """Each named parameter with its interval, and the independent number of the same law."""
    by_law = {fit.law: fit.parameters for fit in fits}
    if "ohm, cooling" in by_law and "reservoir_cooling" in [one["cause"] for one in named(said)]:
        by_law = {"ohm": by_law["ohm, cooling"], "choked, cooling": by_law["ohm, cooling"]}
    for one in named(said):
        for name, value in one.get("parameters", {}).items():
            law, other = SAME.get((one["cause"], name), ("", ""))
            text = f"{one['cause']} {value['estimate']:.4g} ({value['low']:.4g} … {value['high']:.4g})"
            if other in by_law.get(law, {}):
                text += f", independent {by_law[law][other]:.4g}"
            yield text


def show(looked: Sequence[Looked], console: Console) -> None:
    """The tables, in Markdown. Errors on unseen readings are divided by the measured range."""
    console.print("\nVerdicts of diagnose\n")
    titles = ("case", "verdict", "causes and shares", "remainder", "unseen before", "after", "noise", "time")
    table = _table(*titles)
    for one in looked:
        said, held = one.said, one.said["held_out"]
        unseen = (f"{held[key]:.2%}" for key in ("nrmse_before", "nrmse_after", "noise_floor"))
        cells = (said["cause"], _causes(said), _remainder(said.get("remainder")))
        table.add_row(one.name, *cells, *unseen, f"{one.seconds:.0f} s")
    console.print(table)
    console.print("\nParameters, and those of an independent fit of the same law\n")
    table = _table("case", "parameters", "impossible", "rms baseline", "diagnose", "independent")
    for one in looked:
        rms_kPa = (*one.rms_kPa, one.fits[0].rms_kPa)
        texts = ("; ".join(compared(one.said, one.fits)), "; ".join(impossible(one.said)))
        table.add_row(one.name, *texts, *(f"{value:.2f} kPa" for value in rms_kPa))
    console.print(table)
    console.print("\nIndependent fits, the best of a case first\n")
    table = _table("case", "law", "parameters", "rms")
    for one in looked:
        for fit in one.fits:
            numbers = ", ".join(f"{name} {value:.4g}" for name, value in fit.parameters.items())
            table.add_row(one.name, fit.law, numbers, f"{fit.rms_kPa:.3f} kPa")
    console.print(table)


def _causes(said: Mapping[str, Any]) -> str:
    def text(one: Mapping[str, Any]) -> str:
        share = one.get("share")
        return one["cause"] if share is None else f"{one['cause']} {share:.0%}"

    names = ", ".join(text(one) for one in named(said))
    return f"(best tried: {names})" if said["cause"] == UNEXPLAINED else names


def _remainder(remainder: Any) -> str:
    """The remainder as text. Older verdicts have only the feature on which the residuals depend."""
    if not isinstance(remainder, dict):
        return remainder or ""
    share, feature = remainder.get("share"), remainder.get("depends_on")
    return f"{share:.1%} {feature or ''}".strip() if share is not None else feature or ""


def _table(*names: str) -> Table:
    table = Table(box=box.MARKDOWN)
    for name in names:
        table.add_column(name)
    return table


if __name__ == "__main__":
    sys.exit(main())

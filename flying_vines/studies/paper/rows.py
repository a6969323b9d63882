"""The table: every number of the paper, our number, and whether they agree. `rows.toml` lists its rows."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from string import Formatter
from typing import Any, Literal

import numpy as np

from flying_vines.physics import paper
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.studies.paper.compare import (
    BAND,
    HIGH_RESISTANCE,
    SINE_VOLUME_L,
    STEP_TEST_S,
    Curves,
    DischargeCurve,
    FrequencyResponse,
    StepResponse,
    distance_dB,
    full_flow_SLPM,
    last_crossing_Hz,
    rated_resistance_kPa_s_per_SL,
    rms,
    window_s,
)
from flying_vines.studies.paper.data import PrintedCurve, Stated, curve, stated

RowVerdict = Literal["agrees", "differs", "undecided"]
By = Literal["equation", "data", "plant", "high-fidelity", "text"]
Subject = dict[str, Any]
"""Fields that the texts and the numbers of a row can name."""
CRITERIA = {"differs", "bound", "at_most", "margin", "rounded", "within", "within_absolute"}
"""Keys of a row that decide whether the numbers agree."""


@dataclass(frozen=True)
class PaperRow:
    """One line of the table."""

    key: str
    """Stable key; its first word is the chapter."""
    quantity: str
    unit: str
    paper: float | None
    """Stated by the paper, or computed from its numbers; None if the paper has no number."""
    paper_to: float | None
    """The upper end if the paper gives a range."""
    ours: float | None
    """None if we do not compute it."""
    by: By
    """Source of our number: the paper's equation, printed data or text, or one of the simulated plants."""
    verdict: RowVerdict
    place: str
    note: str
    comparable: bool = True
    """False if the two numbers are errors, whose ratio has no meaning."""
    bound: Literal["", ">", "<"] = ""
    """The paper's number is a lower (>) or upper (<) bound."""

    @property
    def relative_difference(self) -> float | None:
        """(ours − paper) / paper; for a range, from its nearer end, and 0 within.

        None if a number is missing, if the paper's number is 0, or if the ratio has no meaning.
        """
        if not self.comparable or self.paper is None or self.ours is None or self.paper == 0.0:
            return None
        if self.paper_to is not None:
            if self.paper <= self.ours <= self.paper_to:
                return 0.0
            if self.ours > self.paper_to:
                return (self.ours - self.paper_to) / self.paper_to
        return (self.ours - self.paper) / self.paper


@dataclass(frozen=True)
class PaperComparison:
    """The table, and the arrays behind it."""

    rows: tuple[PaperRow, ...]
    """In the paper's order of chapters."""
    findings: tuple[str, ...]
    """Contradictions within the paper."""
    curves: Curves


def comparison(curves: Curves) -> PaperComparison:
    """The whole table, and the findings with the table's numbers."""
    text = resources.files(__package__).joinpath("rows.toml").read_text(encoding="utf-8")
    data, of = tomllib.loads(text), subjects(curves)
    rows = tuple(
        _row(row, {"numbers": stated(), **subject, **words})
        for chapter in data["chapter"]
        for subject in of[chapter.get("of", "paper")]
        for row in chapter["row"]
        for words in row.get("each", [{}])
    )
    numbers: dict[str, Any] = {
        "ours": {row.key: math.nan if row.ours is None else row.ours for row in rows},
        "paper": {row.key: math.nan if row.paper is None else row.paper for row in rows},
        "off": {row.key: 100.0 * (row.relative_difference or 0.0) for row in rows},
    }
    shorter = [-numbers["off"][f"discharge.{d.name}.tau_best"] for d in curves.discharges]
    numbers |= {"least": min(shorter), "most": max(shorter)}
    return PaperComparison(rows, tuple(text.format_map(numbers) for text in data["findings"]), curves)


def _row(row: Mapping[str, Any], subject: Subject) -> PaperRow:
    """A row of `rows.toml` for one subject."""

    def field(name: str) -> Any:
        return Formatter().get_field(name.format_map(subject), (), subject)[0]

    def number(key: str) -> float | None:
        found = field(row[key]) if key in row else None
        value = found.value if isinstance(found, Stated) else found
        return None if value is None or not math.isfinite(value) else float(value)

    papers: Any = field(row["paper"]) if "paper" in row else None
    place = row.get("place") or papers.place
    case = field(row["case"]) if row.get("case", "verdict") != "verdict" else ""
    numbers = number("paper"), number("paper_to"), number("ours")
    verdict: RowVerdict = "undecided"
    if case not in row.get("undecided", ()) and (agree := _agree(row, subject, papers, *numbers)) is not None:
        verdict = "agrees" if agree else "differs"
    note = row["notes"][case or verdict] if "notes" in row else row["note"]
    return PaperRow(
        row["key"].format_map(subject),
        row["quantity"].format_map(subject),
        row["unit"],
        *numbers,
        row["by"],
        verdict,
        place,
        note.format_map({**subject, "row": row}),
        row.get("comparable", True),
        row.get("bound", ""),
    )


def _agree(
    row: Mapping[str, Any],
    subject: Subject,
    papers: Stated | float | None,
    number: float | None,
    to: float | None,
    ours: float | None,
) -> bool | None:
    """True if the numbers agree by the criterion of the row; None if it has none."""
    if not CRITERIA & row.keys():
        return None
    if "differs" in row or number is None or ours is None:
        return False
    if "bound" in row:
        return ours > number if row["bound"] == ">" else ours <= number
    if "at_most" in row:
        return bool(ours <= row["at_most"])
    if to is not None:
        return bool(number - row["margin"] <= ours <= to + row["margin"])
    if isinstance(papers, Stated) and "rounded" in row:
        tolerance = papers.half_digit
    elif "within" in row:
        tolerance = row["within"] * number
    else:
        tolerance = row["within_absolute"]
        tolerance = subject[tolerance] if isinstance(tolerance, str) else tolerance
    # The margin is for rounding errors of binary fractions.
    return bool(abs(ours - number) <= tolerance * (1.0 + 1e-9))


def subjects(curves: Curves) -> dict[str, list[Subject]]:
    """What the chapters of `rows.toml` are about."""
    discharges = [_discharge(d) for d in curves.discharges]
    responses = [
        _response(f, likely, curves.discharges[1].flow_resistance_kPa_s_per_SL)
        for f, likely in zip(curves.frequencies, curves.likely_frequencies, strict=True)
    ]
    sines = zip(("phlosar", "low_supply"), curves.sines, curves.likely_sines, curves.rated_sines, strict=True)
    return {
        "paper": [_paper(curves)],
        "discharges": discharges,
        "ends": [
            {"end": end, **{key: extreme(d[key] for d in discharges) for key in ("nrmse", "nrmse_grid")}}
            for end, extreme in (("least", min), ("most", max))
        ],
        "steps": [_step(*pair) for pair in zip(curves.steps, curves.likely_steps, strict=True)],
        "tests": [{**r, **_other(r, b)} for r, b in zip(responses[:2], curves.baselines, strict=True)],
        "responses": responses,
        "sines": [
            {
                "name": name,
                "s": s,
                "likely": likely,
                "rated": rated,
                "volume_L": SINE_VOLUME_L,
                "low_supply_kPa": curves.low_supply_kPa,
            }
            for name, s, likely, rated in sines
        ],
    }


def _discharge(d: DischargeCurve) -> Subject:
    closed = d.name == HIGH_RESISTANCE
    # The logger's period is the shortest time between two points.
    grid_s = np.arange(0.0, d.measured.x[-1] + 0.01, np.diff(d.measured.x).min())
    off_grid = np.interp(grid_s, d.measured.x, d.measured.y) - d.exponential_kPa(grid_s, d.time_constant_s)
    best_resistance = d.best_time_constant_s * ALPHA_KPA / d.reservoir_volume_L
    return {
        "d": d,
        "drawn_time_constant_s": float(d.model.x[-1]) / math.log(float(d.model.y[0] / d.model.y[-1])),
        "nrmse": d.nrmse_percent(d.time_constant_s),
        "nrmse_grid": 100.0 * rms(off_grid) / float(d.measured.y[0]),
        "nrmse_best": d.nrmse_percent(d.best_time_constant_s),
        "nrmse_plant": d.plants_nrmse_percent(d.plant_kPa),
        "nrmse_likely": d.plants_nrmse_percent(d.likely_kPa),
        "speed": "fast" if np.mean(d.at_points(d.likely_kPa) - d.measured.y) < 0 else "slow",
        "reduced": ", reduced by the ratio of the drawn curves," if closed else "",
        "valve": "closed" if closed else "rated",
        "rated_resistance": rated_resistance_kPa_s_per_SL(),
        "drawn_SLPM": full_flow_SLPM(d.flow_resistance_kPa_s_per_SL),
        "best_SLPM": full_flow_SLPM(best_resistance),
    }


def _step(s: StepResponse, likely: StepResponse) -> Subject:
    test, rate = s.condition, s.model_rate_kPa_per_s
    error, nrmse = stated()[f"{test.name}.rate_error"], stated()[f"{test.name}.nrmse"]
    rated = rated_resistance_kPa_s_per_SL()
    lines_kPa = np.minimum(rate * s.trace["time_s"], test.swing_kPa)
    own_error = 100.0 * (s.rate_kPa_per_s / rate - 1.0)
    return {
        "s": s,
        "likely": likely,
        "name": test.name,
        "label": test.name.upper(),
        "error": error,
        "size": "small" if error.value < 5.0 else "large",
        "own_error": own_error,
        "own_error_size": abs(own_error),
        "rated_rate": paper.inflation_rate_kPa_per_s(test.reservoir_kPa, rated, test.cv_volume_L),
        "nearer_rate": min(
            (s.faster_kPa_per_s, s.slower_kPa_per_s), key=lambda each: abs(each - likely.rate_kPa_per_s)
        ),
        "nrmse": 100.0 * rms(s.trace["cv_reading_kPa"] - lines_kPa) / test.swing_kPa,
        "length_s": STEP_TEST_S,
        **{
            f"window_if_{sign}_s": window_s(test.swing_kPa / rate, measured / rate, nrmse.value / 100.0)
            for sign, measured in (("faster", s.faster_kPa_per_s), ("slower", s.slower_kPa_per_s))
        },
        "end": "arrives" if math.isfinite(s.rise_s) else "never",
    }


def _response(f: FrequencyResponse, likely: FrequencyResponse, resistance: float) -> Subject:
    test, supply = f.condition, f"{f.supply_kPa:.0f}"
    alone = test.name == "tc4"
    rate = paper.inflation_rate_kPa_per_s(f.supply_kPa, resistance, test.cv_volume_L)
    line = curve(f"frequency_model_{test.name}")
    all_gains = {"model": f.model_gain, "plant": f.plant_gain, "likely": likely.plant_gain}
    flow_SLPM = 60.0 * paper.flow_for_rate_SL_per_s(f.peak_rate_kPa_per_s, test.cv_volume_L)
    return {
        "f": f,
        "likely": likely,
        "name": test.name,
        "label": test.name.upper(),
        "series": test.name if alone else f"{test.name}_{supply}",
        "supplied": test.name.upper() if alone else f"{test.name.upper()} on {supply} kPa",
        "line_cutoff_Hz": float(line.x[-1] * line.y[-1]),
        "crosses_1_Hz": last_crossing_Hz(f.measured.x, f.measured.y, 1.0),
        "measured_3dB_Hz": last_crossing_Hz(f.measured.x, f.measured.y, math.sqrt(0.5)),
        "plant_3dB_Hz": last_crossing_Hz(f.measured.x, f.plant_gain, math.sqrt(0.5)),
        "likely_3dB_Hz": last_crossing_Hz(f.measured.x, likely.plant_gain, math.sqrt(0.5)),
        "band": BAND,
        **{f"{name}_dB": f.rms_dB(gains) for name, gains in all_gains.items()},
        **{f"{name}_band_dB": f.rms_dB(gains, BAND) for name, gains in all_gains.items()},
        "flow_SLPM": flow_SLPM,
        "rate_if_amplitude": 2.0 * f.peak_rate_kPa_per_s,
        "flow_if_amplitude_SLPM": 2.0 * flow_SLPM,
        "eq4_cutoff_Hz": paper.cutoff_Hz(rate, test.swing_kPa / 2.0),
    }


def _other(response: Subject, regulator: PrintedCurve) -> Subject:
    """The distances of our models from the off-the-shelf regulator."""
    f, likely = response["f"], response["likely"]
    return {
        "other_model_dB": distance_dB(regulator, f.measured.x, f.model_gain),
        "other_likely_dB": distance_dB(regulator, f.measured.x, likely.plant_gain),
    }


def _paper(curves: Curves) -> Subject:
    numbers, c = stated(), curves.cycles
    command, frequency = numbers["sine.command"].value, numbers["sine.frequency"].value
    tc4 = curves.frequencies[0]
    cutoff = paper.cutoff_Hz(tc4.peak_rate_kPa_per_s, command / 2.0)
    by_model = command * paper.frequency_gain(frequency, cutoff)
    other = curves.baselines[1]
    nearest = abs(other.x - frequency).argmin()
    assert other.std is not None
    deviation_kPa = command * float(other.std[nearest])
    known_kg = sum(numbers[f"mass.{name}"].value for name in ("evp", "dvp", "bottle"))
    phlosar_kg = numbers["mass.phlosar"].value
    return {
        "alpha_kPa": paper.alpha_kPa(),
        "vine": curves.vine_step,
        "likely_tc1": curves.likely_steps[0],
        "tc1": curves.steps[0],
        "tc4": tc4,
        "tc5_supply_kPa": curves.frequencies[1].supply_kPa,
        "baseline_kPa": command * float(other.y[nearest]),
        "deviation_kPa": deviation_kPa,
        "two_deviations_kPa": 2.0 * deviation_kPa,
        "model_kPa": by_model,
        "triangle_kPa": min(command, by_model * math.pi / 2.0),
        "cycles_left": {
            name: getattr(c, name)[-1] for name in ("rigid", "rigid_sine", "pouch", "plant_cycles")
        },
        "known_parts_kg": known_kg,
        "missing_g": 1000 * (phlosar_kg - known_kg),
        "rest_kg": numbers["mass.total"].value - phlosar_kg,
    }

"""The table: every number of the paper, our number, and whether they agree. Its words are in `rows.toml`."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

from flying_vines.physics import paper
from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.studies.paper.compare import (
    BAND,
    HIGH_RESISTANCE,
    STEP_TEST_S,
    Curves,
    DischargeCurve,
    FrequencyResponse,
    StepResponse,
    distance_dB,
    rated_resistance_kPa_s_per_SL,
)
from flying_vines.studies.paper.data import PrintedCurve, Stated, curve, stated

RowVerdict = Literal["agrees", "differs", "undecided"]
By = Literal["equation", "data", "plant", "high-fidelity", "text"]

PLANT_TOLERANCE = 0.1
"""Maximum relative difference of a plant's number that agrees with a measured one."""
FIT_TOLERANCE_PERCENT = 2.0
"""Maximum nRMSE of a discharge that agrees with a measured one."""
FIT_TOLERANCE_DB = 1.0
"""Maximum rms distance of a curve that agrees with measured gains."""


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


def table(curves: Curves) -> tuple[PaperRow, ...]:
    """The whole table, in the paper's order of chapters."""
    chapters: tuple[Callable[[Curves], Iterator[PaperRow]], ...] = (
        _alpha,
        _discharge_curves,
        _discharge_range,
        _discharge_resistance,
        _inflation,
        _frequency,
        _sine,
        _likely_sines,
        _cycles,
        _mass,
    )
    return tuple(row for chapter in chapters for row in chapter(curves))


@cache
def _words() -> dict[str, dict[str, Any]]:
    return tomllib.loads(resources.files(__package__).joinpath("rows.toml").read_text(encoding="utf-8"))


def _row(
    row: str,
    paper_value: Stated | float | None,
    ours: float | None,
    verdict: RowVerdict,
    *,
    paper_to: float | None = None,
    case: str = "",
    **words: Any,
) -> PaperRow:
    """One row of the table.

    Args:
        row: its name in `rows.toml`, from which its key is made.
        paper_value: the paper's number; the place of a stated number is used if `rows.toml` has none.
        ours: our number.
        verdict: whether they agree.
        paper_to: the upper end of the paper's range.
        case: which one of the notes applies, if there are several.
        words: values for the placeholders of the texts.
    """
    texts = _words()[row]
    place = texts.get("place", "")
    if isinstance(paper_value, Stated):
        place, paper_value = place or paper_value.place, paper_value.value

    def finite(value: float | None) -> float | None:
        return None if value is None or not math.isfinite(value) else float(value)

    return PaperRow(
        key=row.format(**words),
        quantity=texts["quantity"].format(**words),
        unit=texts["unit"],
        paper=finite(paper_value),
        paper_to=finite(paper_to),
        ours=finite(ours),
        by=texts["by"],
        verdict=verdict,
        place=place.format(**words),
        note=(texts["notes"][case] if case else texts["note"]).format(**words),
        comparable=texts.get("comparable", True),
        bound=texts.get("bound", ""),
    )


def _near(ours: float, paper_value: float, tolerance: float) -> RowVerdict:
    # The margin is for rounding errors of binary fractions.
    return "agrees" if abs(ours - paper_value) <= tolerance * (1.0 + 1e-9) else "differs"


def _near_plant(ours: float, paper_value: float) -> RowVerdict:
    return _near(ours, paper_value, PLANT_TOLERANCE * paper_value)


def _holds(condition: bool) -> RowVerdict:
    return "agrees" if condition else "differs"


def _alpha(_: Curves) -> Iterator[PaperRow]:
    yield _row("alpha", stated()["alpha"], paper.alpha_kPa(), "undecided")


def _stated_nrmse() -> tuple[Stated, Stated]:
    """The ends of the paper's range."""
    return stated()["discharge.nrmse_least"], stated()["discharge.nrmse_most"]


def _discharge_curves(curves: Curves) -> Iterator[PaperRow]:
    low, high = _stated_nrmse()

    def in_range(percent: float, margin: float = 0.0) -> RowVerdict:
        return _holds(low.value - margin <= percent <= high.value + margin)

    for d in curves.discharges:
        drawn_s = _tau_between_ends(d)
        yield _row(
            "discharge.{d.name}.tau",
            drawn_s,
            d.time_constant_s,
            _near(d.time_constant_s, drawn_s, 1e-3 * d.time_constant_s),
            d=d,
        )
        yield _row(
            "discharge.{d.name}.nrmse",
            low,
            d.nrmse_percent,
            in_range(d.nrmse_percent),
            paper_to=high.value,
            d=d,
        )
        yield _row(
            "discharge.{d.name}.nrmse_grid",
            low,
            d.nrmse_grid_percent,
            in_range(d.nrmse_grid_percent, margin=0.1),
            paper_to=high.value,
            d=d,
        )
        yield _row(
            "discharge.{d.name}.nrmse_plant",
            d.nrmse_percent,
            d.nrmse_plant_percent,
            _near(d.nrmse_plant_percent, d.nrmse_percent, 0.001),
            d=d,
            low=low,
        )
        yield _row(
            "discharge.{d.name}.nrmse_likely",
            d.nrmse_percent,
            d.nrmse_likely_percent,
            _holds(d.nrmse_likely_percent <= FIT_TOLERANCE_PERCENT),
            d=d,
            low=low,
            limit_percent=FIT_TOLERANCE_PERCENT,
            reduced=", reduced by the ratio of the drawn curves," if d.name == HIGH_RESISTANCE else "",
            speed="fast" if d.likely_is_fast else "slow",
        )
        yield _row(
            "discharge.{d.name}.tau_best",
            d.time_constant_s,
            d.best_time_constant_s,
            _near(d.best_time_constant_s, d.time_constant_s, 0.02 * d.time_constant_s),
            d=d,
        )


def _discharge_range(curves: Curves) -> Iterator[PaperRow]:
    low, high = _stated_nrmse()
    # The paper prints only some of the logged points, so the ends of its range cannot be checked.
    for end, number, extreme in (("least", low, min), ("most", high, max)):
        yield _row(
            "discharge.nrmse_{end}",
            number,
            extreme(d.nrmse_percent for d in curves.discharges),
            "undecided",
            end=end,
            on_grid=extreme(d.nrmse_grid_percent for d in curves.discharges),
        )


def _discharge_resistance(curves: Curves) -> Iterator[PaperRow]:
    rated = rated_resistance_kPa_s_per_SL()
    for d in curves.discharges:
        closed = d.name == HIGH_RESISTANCE
        ours = d.flow_resistance_kPa_s_per_SL
        yield _row(
            "discharge.{d.name}.resistance",
            rated,
            ours,
            "undecided" if closed else _near(ours, rated, 0.05 * rated),
            case="closed" if closed else "rated",
            d=d,
            drawn_SLPM=_full_flow_SLPM(ours),
            best_SLPM=_full_flow_SLPM(d.best_time_constant_s * ALPHA_KPA / d.reservoir_volume_L),
        )


def _full_flow_SLPM(flow_resistance_kPa_s_per_SL: float) -> float:
    return 60.0 * paper.flow_SL_per_s(stated()["reservoir.pressure"].value, flow_resistance_kPa_s_per_SL)


def _tau_between_ends(d: DischargeCurve) -> float:
    first, last = float(d.model.y[0]), float(d.model.y[-1])
    return float(d.model.x[-1]) / math.log(first / last)


def _inflation(curves: Curves) -> Iterator[PaperRow]:
    for s, likely in zip(curves.steps, curves.likely_steps, strict=True):
        yield from _step(s)
        yield from _likely_step(likely)
    yield _row(
        "inflation.tc1.overshoot_vine",
        None,
        curves.vine_step.overshoot_kPa,
        "undecided",
        vine=curves.vine_step,
        likely=curves.likely_steps[0],
    )


def _likely_step(s: StepResponse) -> Iterator[PaperRow]:
    label = s.condition.name.upper()
    nearer = min(s.faster_kPa_per_s, s.slower_kPa_per_s, key=lambda rate: abs(rate - s.rate_kPa_per_s))
    yield _row(
        "inflation.{s.condition.name}.rate_likely",
        nearer,
        s.rate_kPa_per_s,
        _near_plant(s.rate_kPa_per_s, nearer),
        s=s,
        label=label,
    )
    yield _row(
        "inflation.{s.condition.name}.overshoot_likely",
        None,
        s.overshoot_kPa,
        "undecided",
        s=s,
        label=label,
    )


def _step(s: StepResponse) -> Iterator[PaperRow]:
    name, numbers = s.condition.name, stated()
    error, nrmse = numbers[f"{name}.rate_error"], numbers[f"{name}.nrmse"]
    words: dict[str, Any] = {"s": s, "label": name.upper(), "error": error, "length_s": STEP_TEST_S}
    size = "small" if error.value < 5.0 else "large"
    yield _row("inflation.{s.condition.name}.rate_model", None, s.model_rate_kPa_per_s, "undecided", **words)
    for sign, rate in (("faster", s.faster_kPa_per_s), ("slower", s.slower_kPa_per_s)):
        yield _row(
            "inflation.{s.condition.name}.rate_if_{sign}",
            rate,
            s.rate_kPa_per_s,
            _near_plant(s.rate_kPa_per_s, rate),
            sign=sign,
            **words,
        )
    own_error = 100.0 * (s.rate_kPa_per_s / s.model_rate_kPa_per_s - 1.0)
    yield _row(
        "inflation.{s.condition.name}.rate_error",
        error,
        abs(own_error),
        _near(abs(own_error), error.value, 1.0),
        case=size,
        own_error=own_error,
        **words,
    )
    yield _row("inflation.{s.condition.name}.nrmse", nrmse, s.nrmse_percent, "undecided", case=size, **words)
    yield _row(
        "inflation.{s.condition.name}.overshoot",
        None,
        s.overshoot_kPa,
        "undecided",
        case="arrives" if math.isfinite(s.rise_s) else "never",
        **words,
    )


def _frequency(curves: Curves) -> Iterator[PaperRow]:
    tc4, tc5_low, tc5_full = curves.frequencies
    for f in (tc4, tc5_low):
        yield from _cutoffs(f)
    for f, likely in zip(curves.frequencies, curves.likely_frequencies, strict=True):
        yield from _distance(f, "plant_3dB", "")
        yield from _distance(likely, "likely_3dB", "_likely")
    for f, regulator in zip((tc4, tc5_low), curves.baselines, strict=True):
        yield _other_regulator(f, curves, regulator)
    yield from _flows(tc4)
    yield from _flows(tc5_low)
    yield _rate(curves)
    yield from _supply(curves, tc5_low, tc5_full)


def _cutoffs(f: FrequencyResponse) -> Iterator[PaperRow]:
    name, numbers = f.condition.name, stated()
    text, drawn = numbers[f"{name}.cutoff_modelled"], numbers[f"{name}.cutoff_drawn"]
    measured = numbers[f"{name}.cutoff_measured"]
    words: dict[str, Any] = {"name": name, "label": name.upper()}
    line = curve(f"frequency_model_{name}")
    from_line = float(line.x[-1] * line.y[-1])
    yield _row(
        "frequency.{name}.cutoff_drawn",
        drawn,
        from_line,
        _near(from_line, drawn.value, 1e-3 * drawn.value),
        **words,
    )
    rounded = _near(drawn.value, text.value, text.half_digit)
    yield _row(
        "frequency.{name}.cutoff_stated", text, drawn.value, rounded, case=rounded, drawn=drawn, **words
    )
    yield _row(
        "frequency.{name}.crosses_1",
        measured,
        f.measured_crosses_1_Hz,
        _near(f.measured_crosses_1_Hz, measured.value, measured.half_digit),
        **words,
    )
    yield _row("frequency.{name}.measured_3dB", measured, f.measured_3dB_Hz, "differs", **words)


def _distance(f: FrequencyResponse, three_dB: str, suffix: str) -> Iterator[PaperRow]:
    """Rows for a plant's distance from the measured gains; `three_dB` and `suffix` complete their names."""
    name, supply = f.condition.name, f"{f.supply_kPa:.0f}"
    alone = name == "tc4"
    words: dict[str, Any] = {
        "series": name if alone else f"{name}_{supply}",
        "label": name.upper() if alone else f"{name.upper()} on {supply} kPa",
        "limit_dB": FIT_TOLERANCE_DB,
        "band": BAND,
    }
    yield _row(
        f"frequency.{{series}}.{three_dB}",
        f.measured_3dB_Hz,
        f.plant_3dB_Hz,
        _near_plant(f.plant_3dB_Hz, f.measured_3dB_Hz),
        **words,
    )
    for part, model_dB, plant_dB in (
        ("rms", f.model_rms_dB, f.plant_rms_dB),
        ("rms_band", f.model_band_rms_dB, f.plant_band_rms_dB),
    ):
        yield _row(
            f"frequency.{{series}}.{part}{suffix}",
            model_dB,
            plant_dB,
            _holds(plant_dB <= FIT_TOLERANCE_DB),
            **words,
        )


def _other_regulator(f: FrequencyResponse, curves: Curves, regulator: PrintedCurve) -> PaperRow:
    likely = next(g for g in curves.likely_frequencies if g.condition == f.condition)
    return _row(
        "frequency.{name}.rms_other",
        distance_dB(regulator, f.measured.x, f.model_gain),
        distance_dB(regulator, likely.measured.x, likely.plant_gain),
        "undecided",
        name=f.condition.name,
        label=f.condition.name.upper(),
    )


def _flows(f: FrequencyResponse) -> Iterator[PaperRow]:
    name, rated = f.condition.name, stated()["evp.flow"].value

    def needed(amplitude_kPa: float) -> tuple[float, float]:
        rate = paper.sine_peak_rate_kPa_per_s(f.cutoff_Hz, amplitude_kPa)
        return rate, 60.0 * paper.flow_for_rate_SL_per_s(rate, f.condition.cv_volume_L)

    words: dict[str, Any] = {"name": name, "label": name.upper()}
    rate, flow = needed(f.condition.swing_kPa)
    yield _row("frequency.{name}.flow_if_amplitude", rated, flow, "differs", rate=rate, **words)
    rate, flow = needed(f.condition.swing_kPa / 2.0)
    yield _row(
        "frequency.{name}.flow_if_peak_to_peak",
        rated,
        flow,
        _near(flow, rated, 0.15 * rated),
        case=name,
        rate=rate,
        **words,
    )


def _rate(curves: Curves) -> PaperRow:
    f, tc1 = curves.frequencies[0], curves.steps[0]
    rate = paper.sine_peak_rate_kPa_per_s(f.cutoff_Hz, f.condition.swing_kPa / 2.0)
    return _row(
        "frequency.tc4.rate",
        tc1.faster_kPa_per_s,
        rate,
        _near(rate, tc1.faster_kPa_per_s, PLANT_TOLERANCE * rate),
    )


def _supply(curves: Curves, low: FrequencyResponse, full: FrequencyResponse) -> Iterator[PaperRow]:
    yield _row("frequency.tc5.supply", full.supply_kPa, low.supply_kPa, "differs")
    resistance = curves.discharges[1].flow_resistance_kPa_s_per_SL
    for f, series in ((curves.frequencies[0], "tc4"), (low, "tc5_345"), (full, "tc5_690")):
        rate = paper.inflation_rate_kPa_per_s(f.supply_kPa, resistance, f.condition.cv_volume_L)
        ours = paper.cutoff_Hz(rate, f.condition.swing_kPa / 2.0)
        yield _row(
            "frequency.{series}.cutoff_eq4",
            f.cutoff_Hz,
            ours,
            _near_plant(ours, f.cutoff_Hz),
            case=series,
            series=series,
            label=f.condition.name.upper(),
            f=f,
        )


def _sine(curves: Curves) -> Iterator[PaperRow]:
    numbers = stated()
    command, frequency = numbers["sine.command"].value, numbers["sine.frequency"].value
    phlosar = numbers["sine.phlosar"]
    for name, s, rated in zip(("phlosar", "low_supply"), curves.sines, curves.rated_sines, strict=True):
        number = numbers[f"sine.{name}"]
        yield _row(
            "sine.{name}",
            number,
            s.peak_to_peak_kPa,
            _near_plant(s.peak_to_peak_kPa, number.value) if name == "phlosar" else "undecided",
            case=name,
            name=name,
            s=s,
            rated=rated,
            low_supply_kPa=curves.low_supply_kPa,
        )
    baseline = curves.baselines[1]
    nearest = abs(baseline.x - frequency).argmin()
    assert baseline.std is not None
    fundamental, deviation = command * float(baseline.y[nearest]), command * float(baseline.std[nearest])
    number = numbers["sine.baseline"]
    yield _row(
        "sine.baseline",
        number,
        fundamental,
        _near(fundamental, number.value, 2.0 * deviation),
        deviation=deviation,
    )
    tc4 = curves.frequencies[0]
    cutoff = paper.cutoff_Hz(
        paper.sine_peak_rate_kPa_per_s(tc4.cutoff_Hz, tc4.condition.swing_kPa / 2.0), command / 2.0
    )
    by_model = command * paper.frequency_gain(frequency, cutoff)
    yield _row(
        "sine.model",
        phlosar,
        by_model,
        _near_plant(by_model, phlosar.value),
        triangle_kPa=min(command, by_model * math.pi / 2.0),
    )


def _likely_sines(curves: Curves) -> Iterator[PaperRow]:
    for name, s in zip(("phlosar", "low_supply"), curves.likely_sines, strict=True):
        number = stated()[f"sine.{name}"]
        yield _row(
            "sine.{name}_likely",
            number,
            s.peak_to_peak_kPa,
            _near_plant(s.peak_to_peak_kPa, number.value) if name == "phlosar" else "undecided",
            case=name,
            name=name,
            s=s,
        )


def _cycles(curves: Curves) -> Iterator[PaperRow]:
    c, numbers = curves.cycles, stated()
    minimum = numbers["cycles.least"]
    for row, ours in (
        ("cycles.demonstration", c.rigid[-1]),
        ("cycles.sine", c.rigid_sine[-1]),
        ("cycles.pouch", c.pouch[-1]),
        ("cycles.plant", c.plant_cycles[-1]),
    ):
        yield _row(row, minimum, float(ours), _holds(ours > minimum.value))
    yield _row("cycles.performed", numbers["cycles.performed"], None, "undecided")


def _mass(_: Curves) -> Iterator[PaperRow]:
    numbers = stated()
    total, phlosar, payload = (numbers[f"mass.{name}"] for name in ("total", "phlosar", "payload"))
    known = sum(numbers[f"mass.{name}"].value for name in ("evp", "dvp", "bottle"))
    yield _row("mass.phlosar", phlosar, known, "undecided", missing_g=1000 * (phlosar.value - known))
    yield _row(
        "mass.total",
        payload,
        total.value,
        _holds(total.value <= payload.value),
        total=total,
        rest_kg=total.value - phlosar.value,
    )
    yield _row("power", numbers["power"], None, "undecided")

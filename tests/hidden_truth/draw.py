"""The tiers: the hidden effects, and how hard they are to find.

| tier | hidden |
| --- | --- |
| `clear` | one cause, as strong as on real rigs |
| `subtle` | a third of that |
| `faint` | weakened until the gap is 300 to 3,000 |
| `worn` | nominal numbers off by up to 2.5 %, which is stated; one clear cause, or none in a quarter |
| `holes` | cells or rows missing, and gaps of 2 s; one clear cause |
| `short` | one run of 20 s; one clear cause |
| `pair` | any two clear causes that are both visible |
| `null` | none: clean, worn, or with holes |
| `outside` | an effect that is not in the table, clear or a third of that |
| `hard` | uneven samples, a column missing, only a discharge, noise misstated; a clear cause, or none (1/4) |
| `several` | three to six causes at once, their strengths spread from clear to a tenth of that |
| `several_outside` | two to four causes, spread likewise, and a clear effect that is not in the table |
| `rounded` | readings rounded, or noise correlated; one clear cause, or none in a quarter |

Every hidden effect is visible: its gap is above `SHOWS` (in `faint`, within `FAINT`). If there are several
effects, the gap of each is that of a fit with all the others, so two effects that look the same are never
hidden together. With rounded readings or correlated noise a gap counts less, in proportion to the information
in a reading. The largest of several gaps is at least `LEADS` times the next one (not in `pair`). A draw
without these properties is drawn again, for example if the Venturi stalls only at pressures that no run
reaches.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from hidden_truth import plans
from hidden_truth.effects import CAUSES, EFFECTS, OUTSIDE, Hidden
from hidden_truth.gap import gap
from hidden_truth.plans import FOUR_RUNS, RUN_S, Plan
from hidden_truth.recording import WITHOUT, make
from hidden_truth.rig import TOLERANCE_PERCENT, draw_rig, worn
from hidden_truth.truth import Truth

TIERS = (
    "clear",
    "subtle",
    "faint",
    "worn",
    "holes",
    "short",
    "pair",
    "null",
    "outside",
    "hard",
    "several",
    "several_outside",
    "rounded",
)
SHOWS = 3_000.0
FAINT = (300.0, 3_000.0)
FAINT_AIM = (400.0, 2_500.0)
SUBTLE = 1.0 / 3.0
WORN_PERCENT = 2.5
SHORT_S = 20.0
HOLES = ("cells", "held", "lost")
STATED_OFF = ((0.4, 0.7), (1.5, 2.5))
SPREAD = 0.1
"""The weakest of several strengths, as a share of a clear one."""
LEADS = 1.25
CONVERTER_STEPS = (0.5, 5.0)
"""In standard deviations of the noise."""
CORRELATION_S = (0.02, 0.2)
NOT_REPLAYED = "x_repeats"
"""A simulation from the inputs cannot show this effect, so no fit can include it together with others."""
_VISCOUS = {"cv_leak": "viscous_leak", "reservoir_leak": "reservoir_viscous_leak"}
_DRAWN = tuple(name for name in CAUSES if name not in _VISCOUS.values())
"""The causes that are drawn. Afterwards half of the leaks become viscous leaks."""
_GAINS = {"cv_sensor_gain", "reservoir_sensor_gain"}
_ATTEMPTS = 60
_FADINGS = 16
_LEAKS = 90
"""Seed of separate random numbers for the leaks; the seeds of the runs count from 1."""


@dataclass(frozen=True)
class NotDrawn(Exception):
    """No draw of this tier and seed is visible in the data: the ranges of strengths are wrong."""

    tier: str
    seed: int


def draw(tier: str, seed: int) -> Truth:
    """The case of this tier and seed; always the same."""
    if tier not in TIERS:
        raise ValueError(f"no tier {tier!r}: there are {', '.join(TIERS)}")
    for attempt in range(_ATTEMPTS):
        stream = (zlib.crc32(tier.encode()), seed, attempt)
        rng = np.random.default_rng([*stream, 0])
        truth = _candidate(tier, seed, stream, rng)
        shown = _faded(truth, rng) if tier == "faint" else _shown(truth)
        if shown is not None:
            return shown
    raise NotDrawn(tier, seed)


def _candidate(tier: str, seed: int, stream: tuple[int, ...], rng: Generator) -> Truth:
    rig, noise = draw_rig(rng)
    variant = {
        "holes": lambda: str(rng.choice(HOLES)),
        "null": lambda: str(rng.choice(("clean", "worn", *HOLES), p=(0.4, 0.3, 0.1, 0.1, 0.1))),
        "hard": lambda: str(rng.choice(("uneven", "discharge", "noise", *WITHOUT))),
        "outside": lambda: str(rng.choice(("clear", "subtle"), p=(0.7, 0.3))),
        "rounded": lambda: str(rng.choice(("rounded", "correlated"))),
    }.get(tier, lambda: "")()
    if variant == "discharge":
        rig = replace(rig, cv_L=None)
    is_worn = "worn" in (tier, variant)
    stated = noise
    if variant == "noise":
        low, high = STATED_OFF[int(rng.integers(2))]
        stated = replace(
            noise,
            cv_kPa=round(noise.cv_kPa * rng.uniform(low, high), 3),
            reservoir_kPa=round(noise.reservoir_kPa * rng.uniform(low, high), 3),
        )
    names: list[str] = []
    if tier == "pair":
        names = [str(name) for name in rng.choice(_DRAWN, 2, replace=False)]
    elif tier == "several":
        names = _together(rng, int(rng.integers(3, 7)))
    elif tier == "several_outside":
        names = _together(rng, int(rng.integers(2, 5)))
        names.append(str(rng.choice([name for name in OUTSIDE if name != NOT_REPLAYED])))
    elif tier == "outside":
        names = [str(rng.choice(OUTSIDE))]
    elif tier != "null" and not (tier in ("worn", "hard", "rounded") and rng.random() < 0.25):
        able = [
            name
            for name in _DRAWN
            if (variant != "discharge" or EFFECTS[name].seen_without_cv)
            and (tier not in ("subtle", "faint") or EFFECTS[name].weaken is not None)
        ]
        names = [str(rng.choice(able))]
    leaks = np.random.default_rng([*stream, _LEAKS])
    names = [_VISCOUS[name] if name in _VISCOUS and leaks.random() < 0.5 else name for name in names]
    hidden = [Hidden(name, EFFECTS[name].draw(rng, rig)) for name in names]
    if tier in ("several", "several_outside"):
        hidden = [_spread(one, rng) for one in hidden]
    if tier == "subtle" or (variant == "subtle" and hidden[0].effect.weaken is not None):
        hidden = [one.weaker(SUBTLE) for one in hidden]
    return Truth(
        tier=tier,
        seed=seed,
        variant=variant,
        hidden=tuple(hidden),
        rig=rig,
        assumed=worn(rng, rig, WORN_PERCENT) if is_worn else rig,
        tolerance_percent=WORN_PERCENT if is_worn else TOLERANCE_PERCENT,
        noise=noise,
        stated=stated,
        plans=_plans(tier, variant, rng),
        stream=stream,
        converter_step=_between(rng, CONVERTER_STEPS) if variant == "rounded" else 0.0,
        correlation_s=_between(rng, CORRELATION_S) if variant == "correlated" else 0.0,
    )


def _together(rng: Generator, number: int) -> list[str]:
    """Different causes, with at most one gain of a sensor: without the Venturi both gains look the same."""
    while True:
        names = [str(name) for name in rng.choice(_DRAWN, number, replace=False)]
        if not set(names) >= _GAINS:
            return names


def _spread(one: Hidden, rng: Generator) -> Hidden:
    """The effect with a share of its strength, if it can be weaker and is in the table."""
    share = _between(rng, (SPREAD, 1.0))
    return one.weaker(share) if one.effect.in_table and one.effect.weaken is not None else one


def _between(rng: Generator, bounds: tuple[float, float]) -> float:
    low, high = np.log(bounds)
    return float(np.exp(rng.uniform(low, high)))


def _plans(tier: str, variant: str, rng: Generator) -> tuple[Plan, ...]:
    if variant == "discharge":
        return (plans.discharge(rng),)
    if tier == "short":
        kind = FOUR_RUNS[int(rng.integers(3))]
        return (kind(rng, plans.steady_time(SHORT_S)),)
    venturi = variant != "without_dvp"
    return tuple(
        kind(
            rng,
            plans.uneven_time(rng, RUN_S) if variant == "uneven" else plans.steady_time(RUN_S),
            venturi,
        )
        for kind in FOUR_RUNS
    )


def _shown(truth: Truth) -> Truth | None:
    """The truth with its gap and shares, the largest effect first; None if an effect is not visible."""
    runs = make(truth)
    if not truth.hidden:
        return replace(truth, gap=gap(truth, runs))
    shows = SHOWS / truth.independent_share
    found = gap(truth, runs, below=shows)
    if found < shows:
        return None
    if len(truth.hidden) == 1:
        return replace(truth, gap=found, shares=(1.0,))
    back: dict[Hidden, float] = {}
    for one in truth.hidden:
        others = tuple(other for other in truth.hidden if other is not one)
        back[one] = gap(truth, runs, known=others, below=shows)
        if back[one] < shows:
            return None
    hidden = tuple(sorted(truth.hidden, key=back.__getitem__, reverse=True))
    if truth.tier != "pair" and back[hidden[0]] < LEADS * back[hidden[1]]:
        return None
    return replace(truth, hidden=hidden, gap=found, shares=tuple(back[one] / found for one in hidden))


def _faded(truth: Truth, rng: Generator) -> Truth | None:
    """The truth with the strength that gives about the wanted gap."""
    aim = float(np.exp(rng.uniform(*np.log(FAINT_AIM))))
    strong = truth.hidden[0]
    low, high = 1e-5, 1.0
    share = SUBTLE
    for _ in range(_FADINGS):
        faded = replace(truth, hidden=(strong.weaker(share),))
        found = gap(faded, make(faded))
        if FAINT[0] <= found <= FAINT[1]:
            return replace(faded, gap=found, shares=(1.0,))
        if found < aim:
            low = share
        else:
            high = share
        # A gap grows about with the square of the strength; outside the bracket, bisect.
        share *= (aim / max(found, 1.0)) ** 0.5
        if not low < share < high:
            share = (low * high) ** 0.5
    return None

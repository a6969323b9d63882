"""The findings in words with their numbers, and as plain numbers for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, isnan, sqrt
from typing import Any

from flying_vines.identification.verdict import parameters_json
from flying_vines.physics.arrays import Array
from flying_vines.physics.rig import Rig
from flying_vines.studies.paper.data import stated
from flying_vines.studies.paper.diagnosis import PaperDiagnosis
from flying_vines.studies.paper.diagnosis.discharge import (
    ALIKE,
    HEAT,
    MORE_AIR,
    NOISES,
    Alike,
    DischargeModel,
    Discharges,
)
from flying_vines.studies.paper.diagnosis.flow_law import FlowLawFit
from flying_vines.studies.paper.diagnosis.response import FLOOR, Account, Responses

SAME = 0.999
"""From this correlation of traces on, these readings cannot separate two causes."""

WANDERING_S = 10.0


def has_heat(candidate: DischargeModel) -> bool:
    """True if the candidate has a gas temperature in the reservoir."""
    return any(name in HEAT for name in candidate.names)


def has_more_air(candidate: DischargeModel) -> bool:
    """True if the candidate has more flow than nominal, or less air in the reservoir."""
    return any(name in MORE_AIR for name in candidate.names)


def findings(diagnosis: PaperDiagnosis) -> tuple[str, ...]:
    """The named causes, their confidence, the open questions, and the experiments for them: one text each."""
    found = diagnosis.discharges
    return (
        _named(found),
        _sure(found),
        _possible(found),
        _identical(found),
        _flow_law(diagnosis.flow_laws),
        _predicted(found),
        _unexplained(found),
        _experiment(diagnosis),
        _sharing(diagnosis),
        *_responses(diagnosis.responses),
    )


def _named(found: Discharges) -> str:
    named = found.named
    wall = named.estimates["reservoir_wall"]["conductance_W_per_K"]
    scale = named.estimates["evp_restriction"]["scale"]
    flow_only = found.of("evp_restriction")
    return (
        "Two causes together: air leaves faster than Ohm's law with the paper's R_v has it, and gas in the "
        f"bottle cools as it leaves. R_v is {scale.estimate:.2f} ({scale.low:.2f} … {scale.high:.2f}) of "
        f"the paper's: {_flow_SLPM(scale.estimate):.1f} SLPM at 690 kPa, where the EVP is rated for "
        f"{stated()['evp.flow'].value:g}. The wall warms the gas with hA = {wall.estimate:.1f} "
        f"({wall.low:.1f} … {wall.high:.1f}) W/K for each bottle. In −2 ln of the evidence the baseline is "
        f"{_range(_beyond(found, found.null, named))} worse, depending on the assumed error; more flow alone "
        f"is {_range(_beyond(found, flow_only, named))} worse."
    )


def _flow_SLPM(scale: float) -> float:
    """Flow of the nominal valve with a scaled resistance."""
    return 60.0 * stated()["reservoir.pressure"].value / (scale * Rig().evp.flow_resistance_kPa_s_per_SL)


def _sure(found: Discharges) -> str:
    heat = found.missed(has_heat)
    more, flow = found.missed(has_more_air), found.missed(lambda c: "evp_restriction" in c.names)
    return (
        "How sure: the best set of causes in which R_v and volume are right and nothing leaks lies "
        f"{_range(more)} above the best of all, the best with R_v right (a leak instead) {_range(flow)}. The "
        "best without gas that cools (the valve settles, and the sensor sits in the line) lies "
        f"{_range(heat)} above the best with it: odds of {_odds(heat)} to 1 for heat. This is only valid if "
        "one of the tested explanations is true; three series without repetition cannot show this."
    )


def _possible(found: Discharges) -> str:
    possible = [c for c in found.open() if c is not found.named]
    cold = [c.label for c in possible if not has_heat(c)]
    texts = [f"{c.label} ({_range(found.above(c))})" for c in possible]
    without = f"Without heat: {'; '.join(cold)}." if cold else "All of them need gas that cools."
    return (
        f"Not told apart from the best, at less than {ALIKE:g} above it by one kind of error or another: "
        f"{'; '.join(texts)}. {without}"
    )


def _identical(found: Discharges) -> str:
    same = [a for a in found.alike if abs(a.correlation) > SAME]
    near = [a for a in found.alike if 0.9 < abs(a.correlation) <= SAME]
    names = sorted({name for a in found.alike for name in (a.first, a.second)})
    blind = [name for name in names if _leaves_nothing(found.alike, name)]
    return (
        "What no discharge can tell: "
        f"{'; '.join(f'{a.first} from {a.second} (traces correlate {a.correlation:+.3f})' for a in same)}; "
        f"{', '.join(blind)} has no effect that initial pressures cannot imitate. Hard to separate: "
        f"{'; '.join(f'{a.first} from {a.second} ({a.correlation:+.2f})' for a in near)}."
    )


def _leaves_nothing(alike: Sequence[Alike], name: str) -> bool:
    return all(isnan(a.correlation) for a in alike if name in (a.first, a.second))


def _flow_law(laws: tuple[FlowLawFit, FlowLawFit]) -> str:
    papers, other = laws
    scale = papers.choked.estimates["evp_restriction"]["scale"].estimate
    return (
        "Whether the valve chokes stays open. With the paper's ratio of the valve's two settings, "
        f"{papers.settings_ratio:.3f}, choked flow and heat lie {_range(papers.choked_above)} above Ohm's "
        f"law and heat, and the flow at 690 kPa is then that of the paper (R_v × {scale:.2f}): the flow law "
        f"explains the difference. With a ratio of {other.settings_ratio:.2f} they lie "
        f"{_range(other.choked_above)} above, but their least-squares error is smaller "
        f"({other.choked.rms_kPa:.1f} against {other.ohm.rms_kPa:.1f} kPa rms). Only a measurement of the "
        "flow can separate a smaller R_v from another flow law."
    )


def _predicted(found: Discharges) -> str:
    def each(candidate: DischargeModel) -> str:
        return " / ".join(f"{p:.2f}" for p in candidate.predicted_percent)

    return (
        "Each series predicted from the two others, rms in % of its first reading (4 L high R_v / 4 L low / "
        f"2 L low): baseline {each(found.null)}, more flow {each(found.of('evp_restriction'))}, "
        f"{found.named.label} {each(found.named)}."
    )


def _unexplained(found: Discharges) -> str:
    level, rounding = found.named.problem.level, found.named.problem.correlated.rounding
    wanders_kPa = level.discrepancy * sqrt(2.0 * (1.0 - exp(-WANDERING_S / level.length)))
    return (
        f"No model is complete: this one leaves {found.named.rms_kPa:.1f} kPa rms, where the logger's steps "
        f"of {found.step_kPa:.3f} kPa account for {rounding:.2f}. The rest drifts by {wanders_kPa:.1f} kPa "
        f"in {WANDERING_S:g} s, and the flow of the series differs by {100.0 * level.between_series:g} %. "
        "The evidence of each finding above takes this into account."
    )


def _experiment(diagnosis: PaperDiagnosis) -> str:
    best = diagnosis.proposal.best
    papers = next(o for o in diagnosis.proposal.outcomes if o.experiment.name == "open")
    worst = best.worst
    return (
        "A minute that would tell heat, valve or sensor line, leak and law of flow apart: fill 2 litres as "
        f"before. {best.experiment.how} With the paper's sensor and logger all pairs then differ by at least "
        f"Δχ² = {worst.delta_chi2:.0f} ({' + '.join(worst.true)} is true, {' + '.join(worst.fitted)} is "
        "fitted), with the same unexplained error as before; with rounding alone it is "
        f"{worst.delta_chi2_rounding:.0f}. With the valve open for a minute, as in the paper, the lowest is "
        f"{papers.worst.delta_chi2:.1f}."
    )


def _sharing(diagnosis: PaperDiagnosis) -> str:
    sharing = diagnosis.proposal.sharing
    valve_kPa, volume_kPa = sharing.ends_kPa
    return (
        f"R_v or volume: no discharge tells (Δχ² = {sharing.discharge_delta_chi2:.0f} in that minute, too). "
        f"Weigh the bottle full of water. Or fill it to {sharing.reservoir_kPa:g} kPa, connect it to an "
        f"empty vessel of {sharing.vessel_L:g} L and wait a minute: it ends at {valve_kPa:.1f} kPa if R_v is "
        f"wrong, at {volume_kPa:.1f} if the volume is (Δχ² = {sharing.delta_chi2_rounding:,.0f} with "
        "rounding alone; read the sensor's zero first)."
    )


def _responses(responses: Responses) -> tuple[str, ...]:
    null, floor, tube = responses.of(), responses.of(FLOOR), responses.of("tube")
    other = next(a for a in responses.other if a.names == (FLOOR,))
    alone = [a for a in responses.accounts if len(a.names) == 1 and a.names[0] not in (FLOOR, "tube")]
    best = min(alone, key=lambda a: a.minus_2_ln)
    return (
        "Frequency responses: the baseline under the paper's regulator is "
        f"{_dB(null.rms_dB)} dB rms off TC4 and TC5, {_dB(null.band_rms_dB)} up to three cut-offs. The "
        f"difference is the flat tail. With a minimum gain of {floor.best[FLOOR]:g}, from drift in an FFT "
        f"over few cycles, it is {_dB(floor.rms_dB)}; with a tube of {tube.best['tube']:g} kPa·s/SL between "
        f"sensor and vessel it is {_dB(tube.rms_dB)}. The best single cause of the catalogue, {best.label}, "
        f"gains {null.minus_2_ln - best.minus_2_ln:.0f} in −2 ln of the evidence, the floor "
        f"{null.minus_2_ln - floor.minus_2_ln:.0f}, the tube {null.minus_2_ln - tube.minus_2_ln:.0f}. TC5's "
        "supply is stated twice; on 690 kPa the floor alone is "
        f"{other.minus_2_ln - floor.minus_2_ln:.0f} worse than on 345 kPa.",
        f"With the floor, {_count_alike(responses)} accounts are within {ALIKE:g} of the best: lag, delay, "
        "dead zone, slow outlet, heating and flow law cannot be separated by these gains. The paper prints "
        "neither the regulator's PID, the valve drivers, the tubes and the outlet, nor any phase. A record "
        "of one test over many whole cycles would separate a floor from a tube; its phase a delay from a "
        "lag.",
    )


def _count_alike(responses: Responses) -> int:
    return sum(responses.above(a) < ALIKE for a in responses.accounts)


def _beyond(found: Discharges, candidate: DischargeModel, other: DischargeModel) -> tuple[float, ...]:
    return tuple(a - b for a, b in zip(found.above(candidate), found.above(other), strict=True))


def _range(values: Sequence[float]) -> str:
    low, high = f"{min(values):.0f}", f"{max(values):.0f}"
    return low if low == high else f"{low} to {high}"


def _odds(above: Sequence[float]) -> str:
    """Odds from differences in −2 ln of the evidence."""
    return _range([exp(0.5 * each) for each in above])


def _dB(values: Sequence[float]) -> str:
    return " and ".join(f"{value:.2f}" for value in values)


def as_json(diagnosis: PaperDiagnosis) -> dict[str, Any]:
    """The findings and numbers as plain lists, numbers and texts."""
    found, proposal, responses = diagnosis.discharges, diagnosis.proposal, diagnosis.responses
    best, sharing = proposal.best, proposal.sharing
    return {
        "findings": list(findings(diagnosis)),
        "discharge": {
            "causes": list(found.named.names),
            "parameters": _parameters(found.named),
            "not_told_apart": [list(c.names) for c in found.open() if c is not found.named],
            "missed": {
                "heat": dict(zip(NOISES, found.missed(has_heat), strict=True)),
                "more_air": dict(zip(NOISES, found.missed(has_more_air), strict=True)),
            },
            "step_kPa": found.step_kPa,
            "unexplained": found.named.problem.level._asdict(),
            "candidates": [
                {
                    "causes": list(c.names),
                    "above_best": dict(zip(NOISES, found.above(c), strict=True)),
                    "parameters": _parameters(c),
                    "rms_kPa": c.rms_kPa,
                    "nrmse_percent": list(c.nrmse_percent),
                    "predicted_percent": list(c.predicted_percent),
                }
                for c in found.candidates
            ],
            "alike": [
                {
                    "causes": [a.first, a.second],
                    "correlation": None if isnan(a.correlation) else a.correlation,
                }
                for a in found.alike
            ],
            "flow_laws": [
                {
                    "settings_ratio": law.settings_ratio,
                    "choked_above_ohm": dict(zip(NOISES, law.choked_above, strict=True)),
                    "rms_kPa": {"ohm": law.ohm.rms_kPa, "choked": law.choked.rms_kPa},
                }
                for law in diagnosis.flow_laws
            ],
        },
        "experiment": {
            "name": best.experiment.name,
            "how": best.experiment.how,
            "outcomes": [
                {
                    "experiment": outcome.experiment.name,
                    "pairs": [
                        {
                            "true": list(pair.true),
                            "fitted": list(pair.fitted),
                            "delta_chi2": pair.delta_chi2,
                            "delta_chi2_rounding": pair.delta_chi2_rounding,
                        }
                        for pair in outcome.pairs
                    ],
                }
                for outcome in proposal.outcomes
            ],
            "time_s": _plain(best.time_s),
            "expected_kPa": {" + ".join(names): _plain(kPa) for names, kPa in best.expected_kPa.items()},
            "sharing": {
                "reservoir_kPa": sharing.reservoir_kPa,
                "vessel_L": sharing.vessel_L,
                "ends_kPa": dict(zip(("evp_restriction", "reservoir_volume"), sharing.ends_kPa, strict=True)),
                "delta_chi2_rounding": sharing.delta_chi2_rounding,
                "discharge_delta_chi2": sharing.discharge_delta_chi2,
            },
        },
        "frequency": {
            "scatter_dB": responses.scatter_dB,
            "accounts": [_account(responses, account, 345.0) for account in responses.accounts]
            + [_account(responses, account, 690.0) for account in responses.other],
        },
    }


def _account(responses: Responses, account: Account, tc5_supply_kPa: float) -> dict[str, Any]:
    return {
        "causes": list(account.names),
        "tc5_supply_kPa": tc5_supply_kPa,
        "above_best": responses.above(account),
        "best": account.best,
        "rms_dB": list(account.rms_dB),
        "band_rms_dB": list(account.band_rms_dB),
    }


def _parameters(candidate: DischargeModel) -> dict[str, dict[str, dict[str, float]]]:
    return {cause: parameters_json(values) for cause, values in candidate.estimates.items()}


def _plain(values: Array) -> list[float]:
    return [float(f"{value:.7g}") for value in values]

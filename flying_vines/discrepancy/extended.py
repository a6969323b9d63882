"""The model, extended by a verdict: a rig file that `simulate` and the fakes take."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.discrepancy.verdict import NONE, UNEXPLAINED, Verdict
from flying_vines.pneumatics.plant.true_rig import TrueRig
from flying_vines.pneumatics.rig import Rig


def extended_rig(rig: Rig, verdict: Verdict) -> TrueRig:
    """The believed rig with what the verdict found: numbers as fitted, and the named causes in it.

    What is found to have none says so; what stays unexplained is as it was believed.
    """
    for key, value in verdict.numbers.items():
        table, name = key.split(".")
        rig = replace(rig, **{table: replace(getattr(rig, table), **{name: value})})
    causes = {} if verdict.cause in (NONE, UNEXPLAINED) else {verdict.cause: verdict.parameters}
    causes |= {named.cause: named.parameters for named in verdict.also}
    return TrueRig(
        believed=rig,
        causes={
            cause: {name: estimate.estimate for name, estimate in parameters.items()}
            for cause, parameters in causes.items()
        },
        none_found=verdict.cause == NONE,
    )

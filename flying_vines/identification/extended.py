"""The model, extended by a verdict: a rig file that `simulate` and the fakes take."""

from __future__ import annotations

from flying_vines.identification.verdict import NONE, Verdict
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import Rig, with_numbers


def extended_rig(rig: Rig, verdict: Verdict) -> TrueRig:
    """The believed rig with what the verdict found: numbers as fitted, and the named causes in it.

    What is found to have none says so; what stays unexplained is as it was believed.
    """
    return TrueRig(
        believed=with_numbers(rig, verdict.numbers),
        causes={
            named.cause: {name: estimate.estimate for name, estimate in named.parameters.items()}
            for named in verdict.named
        },
        none_found=verdict.cause == NONE,
    )

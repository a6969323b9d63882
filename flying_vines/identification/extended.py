"""The rig extended by a verdict: `simulate` and the fakes read it as a rig file."""

from __future__ import annotations

from flying_vines.identification.verdict import NONE, Verdict
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import Rig, with_numbers


def extended_rig(rig: Rig, verdict: Verdict) -> TrueRig:
    """The nominal rig with the fitted numbers and the named causes of the verdict.

    An `unexplained` verdict leaves the rig nominal. `none_found` records a verdict of `none`.
    """
    return TrueRig(
        nominal=with_numbers(rig, verdict.numbers),
        causes={
            named.cause: {name: estimate.estimate for name, estimate in named.parameters.items()}
            for named in verdict.named
        },
        none_found=verdict.cause == NONE,
    )

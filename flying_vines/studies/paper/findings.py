"""Contradictions within the paper, in words."""

from __future__ import annotations

from flying_vines.studies.paper.rows import PaperRow


def findings(rows: tuple[PaperRow, ...]) -> tuple[str, ...]:
    """One text for each finding, with the table's numbers."""
    ours = {row.key: row.ours if row.ours is not None else float("nan") for row in rows}
    paper = {row.key: row.paper if row.paper is not None else float("nan") for row in rows}
    off = {row.key: 100.0 * (row.relative_difference or 0.0) for row in rows}
    series = ("4L_highRv", "4L_lowRv", "2L_lowRv")
    slow = [-off[f"discharge.{name}.tau_best"] for name in series]
    return (
        "The discharge model empties the reservoir too slowly: the τ that fit the measurements best are "
        f"{min(slow):.0f} to {max(slow):.0f} % shorter than the drawn ones, and no measured point lies above "
        "the model. Sec. IV-A calls it conservative, but it predicts longer times than the tests show. "
        f"The R_v of the drawn curves is {off['discharge.2L_lowRv.resistance']:.0f} % above the EVP's rated "
        "one; the best-fitting exponentials of the two tests at low R_v give about the rated flow.",
        "Sec. V-B states the errors of the inflation speed without their sign. TC1 agrees with Eq. 4 to "
        "0.24 %, although Eq. 4 leaves out a back pressure that alone gives 5 %; TC2 and TC3, both with 1 L, "
        "differ by 45 %.",
        "TC1 and TC4 have the same volume and supply. In TC1 the pressure rose at "
        f"{paper['frequency.tc4.rate']:.0f} kPa/s; the cut-off that is drawn for TC4 means "
        f"{ours['frequency.tc4.rate']:.0f} kPa/s. The high-fidelity plant rises at "
        f"{ours['inflation.tc1.rate_likely']:.0f} kPa/s in TC1 and at "
        f"{ours['inflation.tc2.rate_likely']:.0f} kPa/s in TC2. In TC2 the paper measured 49.5 kPa/s, if "
        "the pressure rose faster than by Eq. 4. So the plant agrees with TC4 and TC2, but not with TC1.",
        "A is called the amplitude, but must be peak to peak: as an amplitude it would need "
        f"{ours['frequency.tc4.flow_if_amplitude']:.0f} SLPM in TC4 through a valve that is rated for "
        f"{paper['frequency.tc4.flow_if_amplitude']:g} SLPM. Eq. 5 and 7 hold for half of A.",
        "TC5's supply is stated twice, as 345 kPa and as a fixed source of 690 kPa. By Eq. 4 and 7 the drawn "
        f"cut-off of 0.323 Hz belongs to 690 kPa ({ours['frequency.tc5_690.cutoff_eq4']:.3f} Hz), not to "
        f"345 kPa ({ours['frequency.tc5_345.cutoff_eq4']:.3f} Hz). Around the cut-off the baseline plant on "
        "345 kPa lies below the measured gain, on 690 kPa above it. Up to three cut-offs the high-fidelity "
        f"plant differs by {ours['frequency.tc5_345.rms_band_likely']:.1f} dB on 345 kPa and by "
        f"{ours['frequency.tc5_690.rms_band_likely']:.1f} dB on 690 kPa: choked flow and warm gas compensate "
        "the lower supply. So the measurement fits 345 kPa, but Eq. 4 with the drawn cut-off fits 690 kPa.",
        "The measured cut-offs, 1.6 and 0.22 Hz, are where the gain falls below 1. The −3 dB points are "
        f"{ours['frequency.tc4.measured_3dB']:.2f} and {ours['frequency.tc5.measured_3dB']:.2f} Hz.",
        "The text has 1.35 Hz for the drawn 1.3587 Hz, which rounds to 1.36 Hz.",
        "Eq. 6 assumes a sine, but a response at the maximum rate is a triangle: at 1.2 Hz Eq. 6 gives "
        f"{ours['sine.model']:.0f} kPa peak to peak, and {paper['sine.model']:.0f} kPa were measured.",
        f'"More than 300 cycles" is true with the rate of a triangle ({ours["cycles.demonstration"]:.1f}), '
        f"but not with the greatest rate of a sine ({ours['cycles.sine']:.1f}). Both assume a rigid "
        f"actuator. A pouch that is flat before each inflation gives {ours['cycles.pouch']:.1f}.",
        "Sec. V-A calls the reservoir's volume V_cv.",
    )

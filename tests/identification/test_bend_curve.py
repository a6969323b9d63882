"""Bend-curve fits find a known truth within their intervals; a bad file gives an error of one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flying_vines.config import config
from flying_vines.identification.bend_curve import (
    BendCurveFit,
    Law,
    Pairs,
    PairsError,
    _curve,
    bent_kPa,
    fit,
    load_pairs,
    parse_pairs,
)
from flying_vines.physics.arrays import Array
from flying_vines.vine.curve import BendCurve

TRUTH = Law(bend_max_deg=75.0, dead_kPa=2.5, scale_kPa=11.0, hysteresis_kPa=2.2)
UP = np.linspace(0.0, 20.7, 24)
LOOP = np.concatenate([UP, UP[::-1], UP[::3]])


def measured(law: Law, seed: int, kPa: np.ndarray = LOOP, noise_deg: float = 0.7) -> Pairs:
    rng = np.random.default_rng(seed)
    return Pairs(kPa, law.angles_deg(kPa) + rng.normal(0.0, noise_deg, len(kPa)))


def estimates(found: BendCurveFit) -> tuple[tuple[float, float, float], ...]:
    assert found.hysteresis_kPa is not None
    return found.bend_max_deg, found.dead_kPa, found.scale_kPa, found.hysteresis_kPa


def test_without_noise_the_truth_is_found_exactly() -> None:
    found = fit(measured(TRUTH, 1, noise_deg=0.0))
    assert tuple(found.law) == pytest.approx(tuple(TRUTH), rel=1e-5)
    assert found.rms_deg < 1e-4


def test_the_intervals_contain_the_truth_as_often_as_stated() -> None:
    rng = np.random.default_rng(11)
    held: list[bool] = []
    for seed in range(25):
        law = Law(rng.uniform(50, 120), rng.uniform(0.5, 5), rng.uniform(5, 25), rng.uniform(0.5, 4))
        found = fit(measured(law, seed))
        held.extend(low <= true <= high for (_, low, high), true in zip(estimates(found), law, strict=True))
        assert found.rms_deg == pytest.approx(0.7, rel=0.35)
    # Share of 100 intervals; of 600 intervals 91 to 95 % contained the truth.
    assert np.mean(held) >= 0.87


def test_the_fitted_hysteresis_is_that_by_which_the_vine_flies() -> None:
    """For a changing pressure the written curve gives the same bend as the truth."""
    found = fit(measured(TRUTH, 3))
    curve = BendCurve(found.curve, found.written_hysteresis_kPa)
    kPa = 10.0 + 9.0 * np.sin(np.linspace(0.0, 20.0, 400)) * np.cos(np.linspace(0.0, 7.3, 400))
    true_deg = TRUTH.angles_deg(kPa)
    bent_kPa, off_deg = float(kPa[0]), []
    for pressure, deg in zip(kPa.tolist(), true_deg.tolist(), strict=True):
        bent_kPa = curve.bent_kPa(pressure, bent_kPa)
        off_deg.append(abs(curve.angle_deg(bent_kPa) - deg))
    assert max(off_deg) < 1.5


def test_the_table_is_a_configuration() -> None:
    found = fit(measured(TRUTH, 4))
    profiles = "[profiles.straight]\nsegments = [{ kind = 'step', to_kPa = 0 }]\n"
    limits = "[limits]\nmax_kPa = 20.8\n[switch]\npositions = ['straight', '']\n"
    read = config.parse(found.table + limits + profiles, "my.toml").vine
    assert read.curve == found.curve
    assert read.hysteresis_kPa == found.written_hysteresis_kPa == pytest.approx(2.2, abs=0.2)
    curve = read.bend_curve()
    assert curve.max_kPa == pytest.approx(20.7, abs=0.011)
    straight = np.array([curve.angle_deg(kPa) for kPa in UP])
    np.testing.assert_allclose(straight, found.law.curve_deg(UP), atol=0.01 * straight[-1])


@pytest.mark.parametrize("reach", [0.1, 1.0, 4.0, 10.0, 30.0])
def test_the_written_pieces_follow_the_law_also_where_the_bend_levels_off(reach: float) -> None:
    law = Law(100.0, 2.5, 20.0 / reach, 0.0)
    curve, kPa = BendCurve(_curve(law, 22.5)), np.linspace(0.0, 22.5, 500)
    off = [curve.angle_deg(x) for x in kPa] - law.curve_deg(kPa)
    assert np.abs(off).max() < 0.01 * law.curve_deg(kPa[-1:])[0]


def test_without_a_way_down_the_hysteresis_is_not_known() -> None:
    found = fit(measured(TRUTH, 5, np.linspace(0.0, 20.7, 40)))
    assert found.hysteresis_kPa is None
    assert found.written_hysteresis_kPa == 0.0
    assert "No way down was measured" in found.notes[0]
    low, high = found.bend_max_deg[1:]
    assert low <= TRUTH.bend_max_deg <= high


def test_no_hysteresis_is_reported_as_none() -> None:
    found = fit(measured(TRUTH._replace(hysteresis_kPa=0.0), 6))
    assert found.hysteresis_kPa is not None
    assert found.hysteresis_kPa.low == 0.0
    assert found.written_hysteresis_kPa == 0.0
    assert any("show no hysteresis" in note for note in found.notes)


def s_shaped(kPa: Array) -> Array:
    """A vine that does not follow the exponential law, with a hysteresis of 2 kPa."""
    return 60.0 / (1.0 + np.exp(-(bent_kPa(kPa, 2.0) - 11.0) / 2.0))


@pytest.mark.parametrize("count", [15, 60])
def test_a_vine_that_follows_no_law_gets_a_free_curve(count: int) -> None:
    up = np.linspace(0.0, 20.7, count)
    kPa = np.concatenate([up, up[::-1], up[::2]])
    held = []
    for seed in range(8):
        noise = np.random.default_rng(seed).normal(0.0, 0.7, len(kPa))
        found = fit(Pairs(kPa, s_shaped(kPa) + noise))
        assert not found.follows_law
        assert found.law_rms_deg > 2.0 * found.rms_deg
        assert "free rising curve" in found.notes[0]
        curve = BendCurve(found.curve, found.written_hysteresis_kPa)
        off = [curve.angle_deg(p) - a for p, a in zip(up.tolist(), s_shaped(up).tolist(), strict=True)]
        assert float(np.sqrt(np.mean(np.square(off)))) < 1.5
        assert found.hysteresis_kPa is not None
        held.append(found.hysteresis_kPa.low <= 2.0 <= found.hysteresis_kPa.high)
    assert sum(held) >= 6


def test_a_vine_that_follows_the_law_keeps_it() -> None:
    assert sum(fit(measured(TRUTH, seed)).follows_law for seed in range(10)) >= 9


def test_doubts_are_reported() -> None:
    rng = np.random.default_rng(1)
    rough = Pairs(LOOP, TRUTH.angles_deg(LOOP) + rng.normal(0.0, 6.0, len(LOOP)))
    assert any("residuals are large" in note for note in fit(rough).notes)
    line = Pairs(LOOP, 2.0 * LOOP + rng.normal(0.0, 0.5, len(LOOP)))
    assert any("does not level off" in note for note in fit(line).notes)
    wide = fit(measured(TRUTH._replace(dead_kPa=0.5), 7))
    assert any("wider than the dead zone" in note for note in wide.notes)
    quick = Pairs(LOOP, TRUTH.angles_deg(LOOP), np.linspace(0.0, 5.0, len(LOOP)))
    assert any("lag may look like hysteresis" in note for note in fit(quick).notes)


def test_a_law_that_does_not_fit_is_not_made_certain_by_more_pairs() -> None:
    """With more pairs of an S-shaped vine, the law's interval stays as wide as the law's error."""
    widths = []
    for count in (30, 300):
        up = np.linspace(0.0, 20.7, count)
        kPa = np.concatenate([up, up[::-1]])
        _, low, high = fit(Pairs(kPa, s_shaped(kPa))).bend_max_deg
        widths.append(high - low)
    assert widths[1] > 0.6 * widths[0]


@pytest.mark.parametrize("noise_kPa", [0.0, 0.3])
def test_ways_up_and_down_are_distinguished_in_noise(noise_kPa: float) -> None:
    kPa = np.concatenate([np.linspace(0, 20, 60), np.linspace(20, 5, 40), np.linspace(5, 20, 40)])
    noisy = kPa + np.random.default_rng(2).normal(0.0, noise_kPa, len(kPa))
    rising = Pairs(noisy, kPa).rising
    truly = np.concatenate([np.ones(60), np.zeros(40), np.ones(40)]) > 0
    assert np.mean(rising == truly) > 0.95
    assert not np.any(np.diff(np.flatnonzero(np.diff(rising.astype(int)))) < 10)


HEAD = "pressure_kPa,angle_deg\n"


def rows(kPa: np.ndarray, deg: np.ndarray) -> str:
    return HEAD + "".join(f"{p:.4g},{a:.4g}\n" for p, a in zip(kPa, deg, strict=True))


def test_a_file_with_times_blank_lines_and_more_columns_is_read() -> None:
    lines = [f"{0.5 * i},x,{kPa},{deg}" for i, (kPa, deg) in enumerate(zip(LOOP, 3 * LOOP, strict=True))]
    pairs = parse_pairs("time_s,note, pressure_kPa ,angle_deg\n\n" + "\n".join(lines) + "\n\n", "p.csv")
    np.testing.assert_array_equal(pairs.pressure_kPa, LOOP)
    assert pairs.rate_kPa_per_s == pytest.approx(1.8)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "p.csv:1: the header needs one column 'pressure_kPa'; it contains nothing"),
        ("pressure_psi,angle_deg\n1,2\n", "it contains pressure_psi, angle_deg"),
        (HEAD + "1,2\n2,x\n", "p.csv:3: angle_deg: 'x' is not a number"),
        (HEAD + "1,2\n2\n", "p.csv:3: angle_deg: '' is not a number"),
        (HEAD + "1,2\nnan,4\n", "p.csv:3: pressure_kPa: 'nan' is not a finite number"),
        (rows(UP[:7], UP[:7]), "7 pairs; a fit needs at least 8"),
        (rows(1000 * LOOP, LOOP), "looks like Pa"),
        (rows(101.3 + LOOP, LOOP), "looks like absolute pressure"),
        (rows(LOOP - 101.3, LOOP), "0 at ambient pressure"),
        (rows(LOOP / 100, LOOP), "looks like bar or MPa"),
        (rows(LOOP / 30, LOOP), "only span 0.69 kPa"),
        (rows(LOOP, np.radians(3 * LOOP)), "looks like radians"),
        (rows(LOOP, 1000 * LOOP), "no vine bends that far"),
        (rows(LOOP, 0 * LOOP + 5), "the same in every pair"),
        (rows(LOOP, -3 * LOOP), "the angle falls while the pressure rises"),
        (rows(LOOP, 20 + 1.5 * LOOP - 19.0 * (np.arange(len(LOOP)) > 24)), "start with the straight vine"),
        (rows(LOOP, 3 * LOOP - 60), "start with the straight vine"),
        ("time_s,pressure_kPa,angle_deg\n" + "1,2,3\n" * 9, "time_s does not rise"),
    ],
)
def test_a_file_that_cannot_be_meant_is_one_line(text: str, says: str) -> None:
    with pytest.raises(PairsError) as caught:
        parse_pairs(text, "p.csv")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_angles_below_0_have_no_curve() -> None:
    with pytest.raises(PairsError, match="no curve that rises from 0° fits"):
        fit(Pairs(LOOP, 2.0 * LOOP - 60.0))


def test_a_missing_file_gives_one_line(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_bytes(b"\xff\xfe\x00")
    for name in ("p.csv", "none.csv", "."):
        with pytest.raises(PairsError, match="cannot be read"):
            load_pairs(tmp_path / name)

"""Import of recordings of any layout: guesses for real files, known runs in random layouts, bad input."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from examples import examples
from flying_vines.identification.case import Case, read_case
from flying_vines.identification.diagnose import possible_causes
from flying_vines.identification.importing.answers_file import (
    Answers,
    ImportSetup,
    answers_path,
    read_answers,
    set_answer,
    volume_L,
)
from flying_vines.identification.importing.columns import ImportedColumn, guess_columns
from flying_vines.identification.importing.layout import read_foreign
from flying_vines.identification.importing.rig_guess import Run
from flying_vines.identification.importing.runs import Proposal, is_foreign, propose, write_case
from flying_vines.identification.importing.units import UNITS, Unit, parse_unit, psi_instead, unit_in
from flying_vines.identification.parallel_diagnosis import read_any
from flying_vines.identification.recording import CaseError
from flying_vines.physics.arrays import Array
from flying_vines.physics.gas import GASES

HERE = Path(__file__).parents[1]
EXCERPTS = HERE / "data" / "measured"
SHARED = HERE.parents[1] / "shared" / "measured"
RECORDED = HERE / "data" / "cases" / "case_003"
BOTH = {"cv": 0.1, "reservoir": 2.0}


def meanings(proposal: Proposal) -> dict[str, str]:
    """Meaning and unit of the columns that are used."""
    return {c.meaning: c.unit for c in proposal.answers.columns if c.meaning != "ignored"}


def proposed(path: Path, text: str | bytes, said: Answers | None = None) -> Proposal:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return propose(path, said or Answers(), BOTH)


def written_case(proposal: Proposal) -> Case:
    """The case that the proposal becomes, beside its file."""
    folder = proposal.path.parent / "case"
    write_case([proposal], folder)
    return read_case(folder)


def one_run(proposal: Proposal) -> Run:
    (found,) = proposal.runs.values()
    return found


# Real files.

DISCHARGE = {"time": "s", "reservoir_pressure": "psi"}, "opens"
LEAK = {"time": "ms", "reservoir_pressure": "bar"}, "shut"
PUMP = {"time": "s", "command_kPa": "kPa", "cv_pressure": "kPa", "evp_opening": "0-255"}, "pump"
REAL = {
    "plenum_discharge/20191129_143832.csv": DISCHARGE,
    "plenum_discharge/20191129_143911.csv": DISCHARGE,
    "plenum_discharge/20191129_144019.csv": DISCHARGE,
    "leaking_chambers/Aluminium.csv": LEAK,
    "leaking_chambers/Ultimaker_010.csv": LEAK,
    "leaking_chambers/Ultimaker_020.csv": LEAK,
    "pump_and_chamber/sweep_kp_10.csv": PUMP,
    "pump_and_chamber/sweep_kp_15.csv": PUMP,
    "pump_and_chamber/sweep_kp_20.csv": PUMP,
    "pump_and_chamber/sweep_response_20260121_165542.csv": PUMP,
}
SMALL = {"plenum_discharge.csv": DISCHARGE, "leaking_chamber.csv": LEAK, "pump_and_chamber.csv": PUMP}


@pytest.mark.parametrize(
    ("path", "guess"),
    [(EXCERPTS / name, guess) for name, guess in SMALL.items()]
    + [(SHARED / name, guess) for name, guess in REAL.items()],
    ids=lambda value: value.stem if isinstance(value, Path) else "",
)
def test_the_proposal_on_real_files(path: Path, guess: tuple[dict[str, str], str], tmp_path: Path) -> None:
    if not path.exists():
        pytest.skip(f"{path} is not there")
    proposal = propose(path, Answers(), {"": 0.1})
    assert proposal.missing == ()
    assert meanings(proposal) == guess[0]
    setup = proposal.answers.setup
    assert (setup.outlet or setup.source) == guess[1]
    write_case([proposal], tmp_path)
    (recorded,) = read_case(tmp_path).runs
    if guess is DISCHARGE:
        assert 640.0 < recorded.reservoir_kPa[0] < 680.0
        assert 0.5 < recorded.time_s[np.argmax(recorded.evp_opening)] < 0.7
    elif guess is LEAK:
        assert 720.0 < recorded.reservoir_kPa[0] < 770.0
        assert not recorded.evp_opening.any()
        assert np.median(np.diff(recorded.time_s)) == pytest.approx(0.1, abs=0.002)
    else:
        assert np.nanmax(recorded.cv_kPa) < 40.0
        assert 0.9 < recorded.evp_opening.max() <= 1.0


# Known runs in random layouts.


@cache
def known() -> Run:
    """200 rows of a known run."""
    rows = slice(0, 2000, 10)
    table = np.genfromtxt(RECORDED / "run_3_bends.csv", delimiter=",", names=True)
    return {
        "time": table["time_s"][rows],
        "evp_opening": table["evp_opening"][rows],
        "solenoid": table["solenoid"][rows],
        "cv_pressure": table["cv_pressure_kPa"][rows],
        "reservoir_pressure": table["reservoir_pressure_kPa"][rows],
    }


NAMES = {
    "time": ("Time", "t", "Zeit", "elapsed time", "Timestamp"),
    "evp_opening": ("EVP", "inflation valve", "Pump duty", "fill_valve"),
    "solenoid": ("vent", "Outlet state", "exhaust_valve", "solenoid"),
    "cv_pressure": ("Actuator pressure", "P_chamber", "cv pressure", "Kammerdruck", "feedback"),
    "reservoir_pressure": ("Tank pressure", "P_supply", "reservoir", "Reservoir press.", "upstream pressure"),
}
PRESSURE_UNITS = ("kPa", "psi", "bar", "mbar", "hPa", "Pa", "MPa", "cmH2O", "mmHg")
OPENING_UNITS = {"%": 100.0, "0-255": 255.0, "0-1": 1.0, "0-1023": 1023.0}
TITLES = ("", "Rig 3, second try\n", "Fri Nov 29 2019 14:38:23 GMT-0800\n\n", "# bench\n# 21 °C\n")


@dataclass(frozen=True)
class Written:
    """A random layout."""

    marks: tuple[str, str]
    names: tuple[str, ...]
    units: tuple[str, str]
    opening: str
    time: tuple[str, float]
    absolute: bool
    title: str
    encoding: str
    trailing: bool
    missing: str
    order: tuple[int, ...]
    bracket: str


written = st.builds(
    Written,
    marks=st.sampled_from([(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", ".")]),
    names=st.tuples(*(st.sampled_from(names) for names in NAMES.values())),
    units=st.tuples(st.sampled_from(PRESSURE_UNITS), st.sampled_from(PRESSURE_UNITS)),
    opening=st.sampled_from(sorted(OPENING_UNITS)),
    time=st.sampled_from([("s", 1.0), ("ms", 1e3), ("µs", 1e6)]),
    absolute=st.booleans(),
    title=st.sampled_from(TITLES),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    trailing=st.booleans(),
    missing=st.sampled_from(["nan", "NaN", "N/A", "-", "#N/A"]),
    order=st.permutations(range(5)).map(tuple),
    bracket=st.sampled_from([" ({})", " [{}]", "_{}", " / {}"]),
)


def text_of(run: Run, how: Written) -> str:
    """The run in this layout, as a lab would write it."""
    separator, decimal = how.marks
    unit = dict(zip(("cv_pressure", "reservoir_pressure"), how.units, strict=True))
    columns = []
    for (meaning, values), name in zip(run.items(), how.names, strict=True):
        written_in = values
        if meaning == "time":
            head, written_in = how.bracket.format(how.time[0]), values * how.time[1]
        elif meaning in unit:
            ambient = 101.325 if how.absolute else 0.0
            head = how.bracket.format(unit[meaning] + (" abs" if how.absolute else ""))
            written_in = (values + ambient) / parse_unit(unit[meaning]).factor
        elif meaning == "evp_opening":
            head, written_in = f" ({how.opening})", values * OPENING_UNITS[how.opening]
        else:
            head = ""
        name = (name + head).replace(" ", "_") if separator == " " else name + head
        cells = [f"{x:.9g}".replace(".", decimal) if x == x else how.missing for x in written_in.tolist()]
        columns.append([name, *cells])
    rows = zip(*(columns[at] for at in how.order), strict=True)
    end = separator if how.trailing and separator != " " else ""
    return how.title + "\n".join(separator.join(row) + end for row in rows) + "\n"


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(how=written)
def test_a_known_run_in_any_layout_comes_back(tmp_path: Path, how: Written) -> None:
    run = {name: values.copy() for name, values in known().items()}
    run["cv_pressure"][[7, 50]] = np.nan
    proposal = proposed(tmp_path / "run.csv", text_of(run, how).encode(how.encoding, "replace"))
    assert proposal.missing == (), proposal.missing
    found = one_run(proposal)
    assert set(found) == set(run), meanings(proposal)
    for name, values in run.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-6, atol=1e-4, err_msg=name)


def test_the_written_case_has_the_same_numbers(tmp_path: Path) -> None:
    rows = ["t;P_chamber [bar abs];tank (psi);pump PWM;vent"]
    run = known()
    for t, evp, vent, cv, tank in zip(*run.values(), strict=True):
        row = (1000.0 * t, (cv + 101.325) / 100.0, tank / 6.894757, round(255.0 * evp))
        rows.append(";".join(f"{x:.8g}" for x in row).replace(".", ",") + (";on" if vent else ";off"))
    proposal = proposed(tmp_path / "lab.txt", "\n".join(rows))
    assert meanings(proposal)["time"] == "ms"
    (recorded,) = written_case(proposal).runs
    np.testing.assert_allclose(recorded.time_s, run["time"], atol=1e-6)
    np.testing.assert_allclose(recorded.cv_kPa, run["cv_pressure"], atol=1e-3)
    np.testing.assert_allclose(recorded.reservoir_kPa, run["reservoir_pressure"], atol=1e-3)
    np.testing.assert_allclose(recorded.evp_opening, run["evp_opening"], atol=0.002)
    assert (recorded.solenoid == run["solenoid"]).all()
    assert tomllib.loads((tmp_path / "case" / "rig.toml").read_text())["cv"]["volume_L"] == 0.1


def fall(start_kPa: float, dt_s: float = 0.05, rows: int = 200) -> tuple[Array, Array]:
    """A choked, then subsonic discharge by ISO 6358."""
    t = np.arange(rows, dtype=np.float64) * dt_s
    p = [start_kPa]
    for _ in range(20 * (rows - 1)):
        over = max(0.0, 101.325 / (p[-1] + 101.325) - 0.4) / 0.6
        p.append(p[-1] - dt_s / 20.0 * 1.2 * (p[-1] + 101.325) * max(0.0, 1.0 - over**2) ** 0.5)
    return t, np.array([round(kPa, 1) for kPa in p[::20]])


@pytest.mark.parametrize("start_kPa", [80.0, 100.0, 300.0, 690.0])
def test_psi_under_a_heading_of_kPa_is_called_out(start_kPa: float, tmp_path: Path) -> None:
    t, p = fall(start_kPa)
    assert psi_instead(t, p) == ""
    assert start_kPa < 300.0 or "psi" in psi_instead(t, np.round(p / 6.894757, 1))
    t, p = fall(690.0)
    rows = "\n".join(f"{a:.2f},{b / 6.894757:.1f}" for a, b in zip(t, p, strict=True))
    proposal = proposed(tmp_path / "a.csv", f"Time (s),Tank pressure (kPa)\n{rows}")
    (question,) = proposal.missing
    assert question.key == "columns.2.unit" and "psi or kPa?" in question.text
    set_answer(proposal.answers, question.key, "psi")
    assert one_run(propose(tmp_path / "a.csv", proposal.answers, BOTH))["reservoir_pressure"][
        0
    ] == pytest.approx(690, 1e-3)
    said = Answers(columns=[ImportedColumn(2, "reservoir_pressure", "kPa")])
    assert propose(tmp_path / "a.csv", said, BOTH).missing == ()


def test_halves_of_psi_are_called_out_without_a_fall() -> None:
    t = np.arange(50, dtype=np.float64) * 0.1
    assert "multiples of 0.5" in psi_instead(t, 100.0 - 0.5 * np.round(t * 3.0))
    assert psi_instead(t, 690.0 - 0.5 * np.round(t * 3.0)) == ""


def test_a_chamber_at_300_kPa_is_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = ["time_s,evp_opening,dvp_opening,solenoid,cv_pressure_kPa,reservoir_pressure_kPa"]
    for i in range(100):
        kPa = 300.0 * min(1.0, i / 50) + rng.normal(0.0, 0.15)
        rows.append(f"{i / 10},{int(i < 50)},0,0,{kPa:.3f},{690.0 - i * (i < 50) + rng.normal(0.0, 1.2):.2f}")
    (tmp_path / "run.csv").write_text("\n".join(rows))
    (tmp_path / "rig.toml").write_text("[reservoir]\nvolume_L = 2.0\n[cv]\nvolume_L = 0.5\n")
    assert np.max(read_case(tmp_path).runs[0].cv_kPa) > 299.0


LAYOUTS: dict[str, tuple[str, Callable[[int], str]]] = {
    "clock": ("clock;P [bar]\n", lambda i: (f"23:59:{58 + i}" if i < 2 else f"00:00:{i - 2:02d},5")
              + f";{7 - i / 50}".replace(".", ",")),
    "dates": ("date,pressure (kPa)\n", lambda i: f"2024-02-28T23:59:{i:02d}.250,{600 - i}"),
    "units row": ("t,p\nms,mbar\n", lambda i: f"{i * 1000},{7000 - i}"),
    "units in cells": ("t,p\n", lambda i: f"{i * 1000} ms,{7 - i / 100:.2f} bar"),
    "thousands": ("t / ms\tp / Pa\n", lambda i: f"{i * 1000}\t{600_000.5 - i:,}"),
    "epoch": ("timestamp,pressure_kpa\n", lambda i: f"{1_700_000_000 + i},{600 - i}"),
    "blanks": ("  Time (s)   Pressure (kPa)\n", lambda i: f"  {i}.0    {600 - i}.5"),
}  # fmt: skip


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts(name: str, tmp_path: Path) -> None:
    header, row = LAYOUTS[name]
    proposal = proposed(tmp_path / "a.csv", header + "\n".join(row(i) for i in range(40)))
    found = one_run(proposal)
    assert np.ptp(found["time"]) == pytest.approx(39.0, abs=1.6), meanings(proposal)
    assert found["time"][0] < 1e6
    assert 590.0 < found["reservoir_pressure"][0] < 701.0, meanings(proposal)


def test_pressures_without_a_unit_have_the_same_one(tmp_path: Path) -> None:
    """A logger of absolute sensors in mbar, and names that join two words."""
    rows = [
        "started on:,2026-3-26",
        "ms since midnight,MPRpressure_0,ForcePlate_0,valveOpening_0,RPRpressure_0",
    ]
    cv_mbar = 1012.7
    for i in range(300):
        opening = 20 <= i % 100 < 50
        cv_mbar += 0.03 * (1400.0 - cv_mbar) * opening - 0.01 * (cv_mbar - 1012.7)
        rows.append(f"{37172460 + 100 * i},{cv_mbar:.2f},0.01,{opening:.1f},{1404.0 - 0.05 * i:.2f}")
    proposal = proposed(tmp_path / "a.csv", "\n".join(rows))
    assert meanings(proposal) == {
        "time": "ms",
        "cv_pressure": "mbar abs",
        "evp_opening": "0-1",
        "reservoir_pressure": "mbar abs",
    }
    assert one_run(proposal)["reservoir_pressure"][0] == pytest.approx(39.1, abs=0.1)


HEADINGS: dict[str, tuple[str, Callable[[int], str], dict[str, str]]] = {
    "a target without a unit has that of the reading": (
        "t,Setpoint,Feedback_kPa,PWM",
        lambda i: f"{i / 10},{i // 60},{min(i / 60, 1.0) + i % 2 / 100:.2f},{255 * (i > 20)}",
        {"time": "s", "command_kPa": "kPa", "cv_pressure": "kPa", "evp_opening": "0-255"},
    ),
    "a unit alone is a measured pressure": (
        "ms,valve,thrust_g,tank_g,psi",
        lambda i: f"{90 * i},{int(i > 30)},{i % 7},{-790 - i % 5},{min(max(0, i - 30) / 9, 5 - i % 4):.2f}",
        {"time": "ms", "evp_opening": "0-1", "cv_pressure": "psi"},
    ),
    "a ball valve between two tanks": (
        "millis,speed,valveAngle,setPoint,hp (psi),lp (psi),dp/dt,cv_dimensionless",
        lambda i: f"{20 * i},{i % 9},{9 * min(i, 120 - i)},90,{900 - 5 * i},{i},{i % 4},{i if i > 9 else ''}",
        {"time": "ms", "evp_opening": "0-540", "command_kPa": "psi", "reservoir_pressure": "psi",
         "cv_pressure": "psi"},
    ),
    "a tank that empties through its valve": (
        "time,pressure (kPa),motor_angle",
        lambda i: f"{i / 10},{600 - 8 * min(max(0, i - 30), 50)},{max(0, 25 - abs(i - 55))}",
        {"time": "s", "reservoir_pressure": "kPa", "evp_opening": "%"},
    ),
    "sucked below ambient pressure": (
        "pwm,pressure_kPa,timestamp",
        lambda i: f"{100 + i % 60},{i / 2 if i < 60 else 30 - i},{1_700_000_000 + 3 * i}",
        {"time": "s", "cv_pressure": "kPa", "evp_opening": "0-255"},
    ),
    "a vacuum pump": (
        " Time since start (s) \t Presure (mb)",
        lambda i: f"{2.7 * i:.1f} \t {max(952.0 * 0.8**i, 1.2):e} ",
        {"time": "s", "reservoir_pressure": "mbar abs"},
    ),
    "Dutch": ("tijd,druk (mb)", lambda i: f"{i},{7000 - i}", {"time": "s", "reservoir_pressure": "mbar"}),
    "a barometer may have another unit": (
        "t,tank pressure,barometer",
        lambda i: f"{i / 10},{400.0 * 0.99**i:.2f},{1013.0 + i % 3}",
        {"time": "s", "reservoir_pressure": "kPa", "ambient_pressure": "mbar"},
    ),
    "a chamber that rests at 14 kPa is not in psi": (
        "t,chamber pressure",
        lambda i: f"{i / 10},{14.0 + 26.0 * 0.97**i:.3f}",
        {"time": "s", "reservoir_pressure": "kPa"},
    ),
    "a volume is no pressure": (
        "time(sec) pressure net_flow volume",
        lambda i: f"{i / 50} {600 - i / 10:.1f} {i % 9} {i % 50}",
        {"time": "s", "reservoir_pressure": "kPa"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HEADINGS)
def test_names_of_columns(name: str, tmp_path: Path) -> None:
    header, row, expected = HEADINGS[name]
    found = meanings(proposed(tmp_path / "a.csv", "\n".join([header, *(row(i) for i in range(120))])))
    assert found == expected


@pytest.mark.parametrize("answered", ["cv_pressure", "reservoir_pressure"])
def test_the_other_pressure_is_guessed_if_one_is_answered(answered: str, tmp_path: Path) -> None:
    rows = "\n".join(f"{i / 10},{600.0 * 0.99**i:.2f},{500.0 * 0.98**i:.2f}" for i in range(300))
    (tmp_path / "a.csv").write_text(f"t,a kPa,tank kPa\n{rows}")
    columns = guess_columns(read_foreign(tmp_path / "a.csv"), [ImportedColumn(2, answered)])
    assert {column.meaning for column in columns} == {"time", "cv_pressure", "reservoir_pressure"}


def test_an_error_names_the_meaning_of_each_column(tmp_path: Path) -> None:
    rows = "\n".join(f"{i / 10},{i},{600 - i},{i}" for i in range(40))
    with pytest.raises(CaseError, match=r"2 Angle \(ignored\), 3 tank kPa \(reservoir_pressure\)"):
        proposed(tmp_path / "a.csv", f"t,Angle,tank kPa,chamber kPa\n{rows}")


def test_spikes_of_a_disturbed_sensor_are_left_out(tmp_path: Path) -> None:
    p = [600.0 * 0.99**i + 40.0 * (i < 50) + 0.2 * (i % 3) for i in range(200)]
    for at, kPa in ((20, 2300.0), (21, 2200.0), (120, -400.0), (177, 900.0)):
        p[at] = kPa
    rows = "\n".join(f"{i / 10},{kPa:.1f}" for i, kPa in enumerate(p))
    found = proposed(tmp_path / "a.csv", f"t,tank kPa\n{rows}")
    there = one_run(found)["reservoir_pressure"]
    assert np.isnan(there).sum() == 4
    assert "4 spikes of reservoir_pressure" in "".join(found.notes)
    # Pressures below vacuum are impossible, even if a noisy sensor hides its spikes.
    noise = np.random.default_rng(1).normal(0.0, 60.0, 200)
    noisy = "\n".join(f"{i / 10},{600 + noise[i] if i != 90 else -200:.0f}" for i in range(200))
    found = proposed(tmp_path / "c.csv", f"t,tank kPa\n{noisy}")
    there = one_run(found)["reservoir_pressure"]
    assert np.flatnonzero(np.isnan(there)).tolist() == [90]
    assert "1 spike of reservoir_pressure left out: the sensor was disturbed" in found.notes
    # If readings are too far apart to follow the pressure, a single high one may be true.
    moves = "\n".join(f"{i},{600 * (i % 12 in (5, 8, 9, 10)) + 2 * i}" for i in range(100))
    assert not np.isnan(
        one_run(proposed(tmp_path / "b.csv", f"t,tank kPa\n{moves}"))["reservoir_pressure"]
    ).any()


def test_the_ambient_pressure_of_a_laboratory_is_constant(tmp_path: Path) -> None:
    rows = "\n".join(f"{i / 10},{600.0 * 0.99**i:.2f}" for i in range(300))
    case = written_case(proposed(tmp_path / "a.csv", f"t,tank kPa\n{rows}"))
    assert case.runs[0].ambient_kPa == pytest.approx(101.325, abs=0.1)
    assert "ambient_drop" not in {cause.name for cause in possible_causes(case)}


def test_the_resistance_of_a_valve_that_is_partly_open(tmp_path: Path) -> None:
    fall = 100.0 * np.log(np.array([500.0 * np.exp(-max(0, i - 20) / 100) for i in range(120)]))
    rows = [f"{i / 10},{np.exp(at / 100):.2f},{50 if i >= 20 else 0}" for i, at in enumerate(fall)]
    rows[60] = "6.0,nan,50"
    found = proposed(tmp_path / "a.csv", "\n".join(["t,tank kPa,valve %", *rows]))
    # R V / alpha = 10 s at half the opening, of 2 L.
    assert written_case(found).rig.evp.flow_resistance_kPa_s_per_SL == pytest.approx(
        10.0 * 0.5 * 101.3 / 2.0, rel=0.02
    )


def test_a_cylinder_at_100_bar_is_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    p = 1e4 * 0.98 ** np.arange(200) + rng.normal(0.0, 5.0, 200)
    rows = "\n".join(f"{i / 10},{kPa / 100:.3f}" for i, kPa in enumerate(p))
    found = written_case(proposed(tmp_path / "a.csv", f"t,tank bar\n{rows}"))
    assert np.max(found.runs[0].reservoir_kPa) > 9000.0


def test_several_runs_in_a_file(tmp_path: Path) -> None:
    back = "time_s2,pressure kPa\n" + "\n".join(f"{i % 50 / 10},{600 - i % 50}" for i in range(150))
    assert [len(r["time"]) for r in proposed(tmp_path / "a.csv", back).runs.values()] == [50, 50, 50]
    column = "trial,t (s),tank kPa\n" + "\n".join(f"{i // 60},{i / 10},{600 - i % 60}" for i in range(120))
    assert list(proposed(tmp_path / "b.csv", column).runs) == ["b_1", "b_2"]


@pytest.mark.parametrize("names", ["Druck;Ventil ein;Ventil aus", "pressure;V1;V2", "p;state;open"])
def test_the_two_valves_of_a_gripper_are_told_apart_by_the_pressure(tmp_path: Path, names: str) -> None:
    """0.25 L, 2 s to 90 kPa through a resistance of 400 from 150 kPa, a hold, and a fall through 300."""
    kPa, rows = 0.0, []
    for i in range(800):
        inflates, vents = i % 400 < 200, i % 400 >= 300
        rows.append(f"{20 * i};{kPa / 6.894757:.4f};{int(inflates)};{int(vents)}".replace(".", ","))
        kPa += 0.02 * 101.325 / 0.25 * (inflates * (150.0 - kPa) / 400.0 - vents * kPa / 300.0)
    first, *valves = names.split(";")
    header = ";".join(["Zeit [ms]", f"{first} [psi]", *valves])
    (tmp_path / "a.csv").write_text("\n".join(["Messung 3", header, *rows]))
    found = propose(tmp_path / "a.csv", Answers(), {"": 0.25})
    assert [column.meaning for column in found.answers.columns[1:]] == [
        "cv_pressure",
        "evp_opening",
        "solenoid",
    ]
    rig = written_case(found).rig
    assert rig.solenoid.flow_resistance_kPa_s_per_SL == pytest.approx(300.0, rel=0.02)
    assert rig.pump is not None and rig.pump.stall_pressure_kPa == pytest.approx(150.0, rel=0.02)
    assert rig.tolerance("solenoid.flow_resistance_kPa_s_per_SL") == 80.0


def test_the_valves_between_a_tank_and_a_chamber_are_estimated(tmp_path: Path) -> None:
    tank_kPa, kPa, rows = 400.0, 0.0, []
    for i in range(400):
        opening, vents = 0.5 * (20 <= i < 80), i >= 200
        rows.append(f"{i / 50},{tank_kPa:.3f},{kPa:.3f},{opening},{int(vents)}")
        flow = opening * (tank_kPa - kPa) / 500.0
        tank_kPa -= 0.02 * 101.325 / 5.0 * flow
        kPa += 0.02 * 101.325 / 0.5 * (flow - vents * kPa / 150.0)
    (tmp_path / "a.csv").write_text("\n".join(["t (s),tank kPa,chamber kPa,inlet valve,vent", *rows]))
    rig = written_case(propose(tmp_path / "a.csv", Answers(), {"cv": 0.5, "reservoir": 5.0})).rig
    assert rig.evp.flow_resistance_kPa_s_per_SL == pytest.approx(500.0, rel=0.03)
    assert rig.solenoid.flow_resistance_kPa_s_per_SL == pytest.approx(150.0, rel=0.03)


def test_a_chamber_of_which_only_the_outlet_was_recorded(tmp_path: Path) -> None:
    kPa, rows = 50.0, []
    for i in range(400):
        rows.append(f"{i / 50},{kPa:.3f},{int(100 <= i < 200)}")
        kPa -= (100 <= i < 200) * 0.02 * 101.325 / 0.2 * kPa / 600.0
    (tmp_path / "a.csv").write_text("\n".join(["t,chamber kPa,vent", *rows]))
    case = written_case(propose(tmp_path / "a.csv", Answers(), {"": 0.2}))
    assert case.rig.reservoir.volume_L == 0.2 and np.isfinite(case.runs[0].reservoir_kPa).all()
    assert case.rig.evp.flow_resistance_kPa_s_per_SL == pytest.approx(600.0, rel=0.03)


def test_an_evacuated_vessel_that_leaks(tmp_path: Path) -> None:
    rows = "\n".join(f"{i / 10},{-62.0 * 0.9982**i:.2f}" for i in range(900))
    found = proposed(tmp_path / "cup.csv", f"t(s),vacuum (kPa)\n{rows}")
    assert found.missing == () and found.answers.setup.outlet == "shut"
    run = written_case(found).runs[0]
    assert run.reservoir_kPa[0] == pytest.approx(-62.0) and not run.evp_opening.any()


@pytest.mark.parametrize(
    ("text", "foreign"),
    [
        ("settle_time_s,tank kPa\n0,1\n", True),
        ("t (s),tank kPa,note\n0,1,the former time_s\n", True),
        ("# from the column time_s\nt (s),tank kPa\n0,1\n", True),
        ("\ufefftime_s,cv_pressure_kPa\r\n0,1\r\n", False),
        ('cv_pressure_kPa;"time_s"\r0;1\r', False),
        ("a rig\n# time_s\tcv_pressure_kPa\n0\t1\n", False),
        ("time_s,cv_pressure_kPa,note\n0,1,20 \u00b0C\n", False),
    ],
)
def test_only_a_column_time_s_makes_a_case(text: str, foreign: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode("cp1252" if "\u00b0" in text else "utf-8"))
    assert is_foreign(path) == foreign


def test_a_valve_needs_the_volume_of_its_reservoir(tmp_path: Path) -> None:
    path = copied(tmp_path, "pump_and_chamber.csv")
    pump = propose(path, Answers(), {"cv": 0.1})
    assert pump.missing == () and [question.key for question in pump.questions] == ["setup.source"]
    rig = written_case(pump).rig
    assert rig.pump is not None and 20.0 < rig.pump.stall_pressure_kPa < 120.0
    assert rig.tolerance("pump.free_flow_SL_per_s") == 80.0
    set_answer(pump.answers, "setup.source", "reservoir")
    assert [question.key for question in propose(path, pump.answers).missing] == ["rig.reservoir.volume_L"]


def test_the_gas_is_that_of_the_rig_file(tmp_path: Path) -> None:
    proposal = proposed(
        tmp_path / "a.csv", "t (s),tank kPa\n" + "\n".join(f"{i},{600 - i}" for i in range(40))
    )
    set_answer(proposal.answers, "setup.gas", "CO2")
    assert (
        written_case(propose(tmp_path / "a.csv", proposal.answers, BOTH)).rig.gas.properties == GASES["CO2"]
    )
    (tmp_path / "b.import.toml").write_text('[setup]\ngas = "laughing"\n')
    with pytest.raises(CaseError, match="'laughing' is not a known gas"):
        read_answers(tmp_path / "b.import.toml")


def test_the_outlet_of_a_vessel_alone(tmp_path: Path) -> None:
    t, p = fall(600.0)
    rows = "\n".join(f"{a:.2f},{b},1" for a, b in zip(t, p, strict=True))
    found = proposed(tmp_path / "a.csv", f"t (s),tank kPa,vent\n{rows[:-1]}0")
    assert written_case(found).runs[0].evp_opening[0] == 1.0


@pytest.mark.parametrize("late", [0.0, 0.2, 0.5, 0.8])
def test_an_outlet_opens_before_the_first_reading_that_has_fallen(late: float, tmp_path: Path) -> None:
    """At any time between two readings."""
    t, p = fall(600.0, 0.1)
    p = np.concatenate([np.full(8, 600.0), np.interp(t + 0.1 * (1.0 - late), t, p)])
    rows = "\n".join(f"{0.1 * i:.2f},{kPa:.1f}" for i, kPa in enumerate(p[:100]))
    found = one_run(proposed(tmp_path / "a.csv", f"t (s),tank kPa\n{rows}", Answers()))
    first = int(np.argmax(found["evp_opening"] > 0.0))
    assert (first, found["after_gap"][8]) == (7, 1.0)


def test_the_filling_of_a_vessel_alone_is_left_out(tmp_path: Path) -> None:
    t, p = fall(300.0)
    filling = [(0.1 * i, 2.0 if i < 10 else 15.0 * (i - 9)) for i in range(29)]
    times, pressures = zip(*filling, *zip((t + 2.9).tolist(), p.tolist(), strict=True), strict=True)
    rows = "\n".join(f"{a:.3f},{b}" for a, b in zip(times, pressures, strict=True))
    found = proposed(tmp_path / "a.csv", f"t (s),cuff kPa\n{rows}", Answers())
    assert one_run(found)["time"][0] == pytest.approx(2.9)
    assert "a: the vessel is filled until 2.9 s; these rows are left out" in found.notes
    # A vessel that is full at the start is not cut.
    held = "\n".join(f"{0.05 * i:.2f},{300.0 - i * 0.01 + i % 2}" for i in range(100))
    assert one_run(proposed(tmp_path / "b.csv", f"t (s),cuff kPa\n{held}"))["time"][0] == 0.0


def test_a_column_that_repeats_another(tmp_path: Path) -> None:
    rows = "\n".join(f"{i / 10},{600 - i}.5,{i / 100},{20 - i / 2},{i / 2}" for i in range(20))
    text = "t,tank (kPa),raw tank (V),error,chamber kPa,pump\n" + rows.replace("\n", ",1\n") + ",0"
    found = {c.name: c.meaning for c in proposed(tmp_path / "a.csv", text).answers.columns}
    assert found["tank (kPa)"] == "reservoir_pressure" and found["chamber kPa"] == "cv_pressure"
    assert found["raw tank (V)"] == found["error"] == "ignored"


def test_voltage_needs_a_calibration(tmp_path: Path) -> None:
    text = "t,tank (V)\n" + "\n".join(f"{i / 10},{4.5 - i / 50}" for i in range(60))
    proposal = proposed(tmp_path / "a.csv", text)
    (question,) = proposal.missing
    set_answer(proposal.answers, question.key, "V (0.5=0, 4.5=1000)")
    found = written_case(propose(tmp_path / "a.csv", proposal.answers, BOTH))
    assert found.runs[0].reservoir_kPa[0] == pytest.approx(1000.0)


def test_a_file_without_time_needs_a_rate(tmp_path: Path) -> None:
    text = "tank kPa\n" + "\n".join(f"{600 - i / 3:.3f}" for i in range(60))
    assert [q.key for q in proposed(tmp_path / "a.csv", text).missing] == ["setup.sample_Hz"]
    found = one_run(proposed(tmp_path / "a.csv", text, Answers(setup=ImportSetup(sample_Hz=20.0))))
    assert found["time"][-1] == pytest.approx(59 / 20)


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_units_are_found_in_names(unit: Unit) -> None:
    for word in (unit.name, *unit.words):
        assert parse_unit(word) == unit
        assert unit_in(f"x ({word})") == unit


@pytest.mark.parametrize(
    ("name", "unit"),
    {"Pressure (psig)": "psi", "p_bar_abs": "bar abs", "P [kPaA]": "kPa abs", "t/ms": "ms", "time_s": "s",
     "absolute pressure, mbar": "mbar abs", "PWM_Main": "0-255", "valve %": "%", "T °C": "C"}.items(),
)  # fmt: skip
def test_units_in_their_usual_spellings(name: str, unit: str) -> None:
    found = unit_in(name)
    assert found and found.name == unit


@pytest.mark.parametrize(("said", "litres"), {"0.5": 0.5, "30 cm3": 0.03, "30mL": 0.03, "2 L": 2.0}.items())
def test_volumes(said: str, litres: float) -> None:
    assert volume_L(said) == pytest.approx(litres)


# The command.


def copied(tmp_path: Path, name: str = "plenum_discharge.csv") -> Path:
    return Path(shutil.copy(EXCERPTS / name, tmp_path))


def test_the_command_reports_what_is_missing_and_stores_the_answer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = copied(tmp_path)
    status, _, error = run(capsys, "import", path)
    assert status == 2 and error.count("\n") == 1
    assert "rig.reservoir.volume_L" in error and str(answers_path(path)) in error
    status, out, _ = run(capsys, "import", path, "--volume-L", "30 cm3")
    assert status == 0 and "psi" in out
    assert read_answers(answers_path(path)).rig == {"reservoir": {"volume_L": 0.03}}
    before = answers_path(path).read_text()
    assert run(capsys, "import", path)[0] == 0
    assert answers_path(path).read_text() == before
    assert path.with_name("plenum_discharge-import.png").stat().st_size > 5000
    assert len(read_any(path).runs) == len(read_case(tmp_path / "plenum_discharge-case").runs) == 1


def test_questions_on_a_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = copied(tmp_path, "pump_and_chamber.csv")
    said = iter(["much", "0.2 L", ""])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: next(said))
    assert run(capsys, "import", path, "--to", tmp_path / "case")[0] == 0
    answers = read_answers(answers_path(path))
    assert answers.rig["cv"] == {"volume_L": 0.2} and answers.setup.source == "pump"
    assert read_case(tmp_path / "case").rig.cv is not None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--column", "3=cv_pressure:psi"], "no column 3"),
        (["--column", "2=pressure"], "not a meaning"),
        (["--column", "2=cv_pressure:stone"], "not a unit"),
        (["--column", "x"], "column 'x'"),
        (["--volume-L", "0"], "positive"),
        (["--volume-L", "tank=1"], "no vessel"),
    ],
)
def test_wrong_options(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, _, error = run(capsys, "import", copied(tmp_path), *arguments)
    assert status == 2 and error.count("\n") == 1 and words in error


@pytest.mark.parametrize(
    "text", ["[setup]\noutlet = 'x'", "x = 1", "[[columns]]\nnumber = 'a'", "[rig.tank]\na = 1", "="]
)
def test_wrong_answers(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = copied(tmp_path)
    answers_path(path).write_text(text)
    status, _, error = run(capsys, "import", path)
    assert status == 2 and error.count("\n") == 1 and "plenum_discharge.import.toml" in error


@settings(max_examples=examples(150), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.binary(max_size=400)
    | st.text("0123456789.,;:-+eE \t\n\"'/apkPst", max_size=300).map(str.encode)
    | st.lists(st.tuples(*[st.floats(width=32) | st.sampled_from(["", "x", "1e99"])] * 3), min_size=8).map(
        lambda rows: "\n".join(",".join(map(str, row)) for row in rows).encode()
    )
)
@example(b"PK\x03\x04")
@example(b"t,tank kPa\n" + b"1,1\n" * 20)
def test_random_files_give_a_proposal_or_one_line(tmp_path: Path, data: bytes) -> None:
    try:
        proposal = proposed(tmp_path / "a.csv", data)
        write_case([proposal] if not proposal.missing else [], tmp_path / "case") if proposal.runs else None
    except CaseError as error:
        assert str(error).isprintable()
        assert "a.csv" in str(error) or "case" in str(error)
    for left in (tmp_path / "case").glob("*"):
        left.unlink()


def test_a_table_keeps_its_remarks(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,p\n" + "1,2\n" * 5 + "error: sensor lost\n" + "2,3\n" * 5 + "3")
    table = read_foreign(tmp_path / "a.csv")
    assert len(table.cells[0]) == 10
    assert table.remarks == ("a.csv: left out 2 lines without numbers below the first row",)

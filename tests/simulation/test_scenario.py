"""Scenario files: content and errors."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from flying_vines.physics.plant.true_rig import true_rig_from
from flying_vines.simulation.scenario import ScenarioError, load_scenario, parse_scenario
from flying_vines.simulation.scenario.scenario import (
    BendsRun,
    ChirpRun,
    DischargeRun,
    OpeningsRun,
    PrbsRun,
    ProfileRun,
    SineRun,
    StepsRun,
    examples,
)

EVERY_KIND = """
[[runs]]
kind = "steps"
pressures_kPa = [10, 5]
hold_s = [1, 2.5]
[[runs]]
kind = "sine"
high_kPa = 10
frequency_Hz = 1
duration_s = 2
[[runs]]
kind = "chirp"
high_kPa = 10
from_Hz = 1
to_Hz = 2
duration_s = 2
[[runs]]
kind = "prbs"
levels_kPa = [1, 2]
duration_s = 2
[[runs]]
kind = "discharge"
duration_s = 2
[[runs]]
kind = "bends"
cycles = 2
[[runs]]
kind = "openings"
valves = [{ for_s = 1, evp = 0.5 }, { for_s = 2, solenoid = true }]
[[runs]]
kind = "profile"
segments = [{ kind = "ramp", to_kPa = 10, over_s = 2 }, { kind = "step", to_kPa = 4 }]
rate_kPa_per_s = 6
settle_s = 1
"""


def test_every_kind_is_read_with_its_length() -> None:
    runs = parse_scenario(EVERY_KIND, "all").runs
    assert [type(run) for run in runs] == [
        StepsRun,
        SineRun,
        ChirpRun,
        PrbsRun,
        DischargeRun,
        BendsRun,
        OpeningsRun,
        ProfileRun,
    ]
    assert [run.length_s for run in runs] == pytest.approx([3.5, 2, 2, 2, 2, 5, 3, 4])
    assert [run.label for run in runs] == (
        ["steps", "sine", "chirp", "prbs", "discharge", "bends", "openings", "profile"]
    )
    assert all(run.reservoir_kPa == 690.0 and run.sample_rate_Hz == 50 for run in runs)


def test_examples_are_there_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert examples() == ("case", "discharge")
    assert [run.label for run in load_scenario("case").runs] == ["steps", "prbs", "bends", "hold"]
    assert [run.length_s for run in load_scenario("case").runs] == [45.0] * 4
    assert isinstance(load_scenario("discharge").runs[0], DischargeRun)


def test_a_file_goes_before_an_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("case").write_text('name = "mine"\n[[runs]]\nkind = "bends"\ncycles = 1\n')
    assert load_scenario("case").name == "mine"


RUN = "[[runs]]\n"
BENDS = RUN + 'kind = "bends"\ncycles = 1\n'
SINE = RUN + 'kind = "sine"\nduration_s = 1\nfrequency_Hz = 1\nhigh_kPa = 10\n'
PRBS = RUN + 'kind = "prbs"\nduration_s = 1\n'
STEPS = RUN + 'kind = "steps"\npressures_kPa = [1, 2]\n'
OPENINGS = RUN + 'kind = "openings"\nvalves = [{ for_s = 1, '
PROFILE = RUN + 'kind = "profile"\nsegments = ['


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the section [[runs]] is missing"),
        ("runs = []", "runs: must be a list of 1 to 20 tables, not []"),
        ("runs = 3", "runs: must be a list of 1 to 20 tables, not 3"),
        (BENDS + "[other]\n", "other: unknown key"),
        ("nam = 'x'\n" + BENDS, "nam: unknown key; did you mean 'name'?"),
        (RUN + "cycles = 1", "runs[0]: 'kind' is missing"),
        (RUN + 'kind = "bend"', "runs[0].kind: must be one of steps, sine, chirp, "),
        (RUN + 'kind = "bends"', "runs[0]: 'cycles' is missing"),
        (BENDS + "holds_s = 1", "runs[0].holds_s: unknown key; did you mean 'hold_s'?"),
        (BENDS + BENDS + 'hold_s = "a"', "runs[1].hold_s: must be a number"),
        (BENDS + "bend_kPa = nan", "runs[0].bend_kPa: is not a finite number"),
        (BENDS + "bend_kPa = 151", "runs[0].bend_kPa: must be a number from 0 to 150, not 151"),
        (BENDS + "reservoir_kPa = 0", "runs[0].reservoir_kPa: must be a number from 1 to 900, not 0"),
        (BENDS + "sample_rate_Hz = 60", "runs[0].sample_rate_Hz: 60 does not divide the firmware's 1000 Hz"),
        (BENDS + 'name = "../x"', "runs[0].name: must be a text in quotes of 1 to 40 letters"),
        (BENDS + 'name = "x\\n"', "runs[0].name: "),
        (BENDS.replace("1", "1000") + "hold_s = 3600", "runs[0]: a run of "),
        (SINE + "low_kPa = 10", "runs[0].high_kPa: must be above low_kPa"),
        (SINE.replace("Hz = 1", "Hz = 26"), "runs[0].sample_rate_Hz: 50 samples a second cannot show 26 Hz"),
        (PRBS, "runs[0]: give either levels_kPa or levels_opening"),
        (PRBS + "levels_kPa = [1, 1]", "runs[0].levels_kPa: give at least two levels"),
        (PRBS + "levels_opening = [0, 2]", "runs[0].levels_opening[1]: must be a number from 0 to 1, not 2"),
        (PRBS + "levels_kPa = [0, 2]\nmin_hold_s = 2", "runs[0].max_hold_s: must not be below min_hold_s"),
        (PRBS + "levels_kPa = [0, 2]\nmin_hold_s = 0.01", "runs[0].min_hold_s: is shorter than a sample"),
        (
            STEPS + "hold_s = [1]",
            "runs[0].hold_s: 1 times for 2 pressures; give one time, or one per pressure",
        ),
        (OPENINGS + "env = 1 }]", "runs[0].valves[0].env: unknown key; did you mean 'evp'?"),
        (
            PROFILE + '{ kind = "hold", for_s = 1 },' * 11 + "]\nrepeat = 1000",
            "runs[0].repeat: makes a profile of more than 10000 segments",
        ),
        (
            PROFILE + '{ kind = "step", to_deg = 3 }]',
            "runs[0].segments[0].to_deg: a scenario has no bend curve; give kPa",
        ),
        (
            PROFILE + '{ kind = "hold", for_s = 1 }, { kind = "step", to_kPa = -3 }]',
            "runs[0].segments[1].to_kPa: -3 is outside 0…150 kPa",
        ),
        (
            PROFILE + '{ kind = "profile", name = "x" }]',
            "runs[0].segments[0].kind: must be one of step, ramp, hold, sine, not 'profile'",
        ),
    ],
)
def test_an_error_gives_one_line_with_file_and_key(text: str, says: str) -> None:
    with pytest.raises(ScenarioError) as raised:
        parse_scenario(text, "mine.toml")
    sentence = str(raised.value)
    assert re.match(rf"mine\.toml:(\d+:)? {re.escape(says)}", sentence), sentence
    assert sentence.isprintable()


def test_a_text_that_is_not_toml_is_an_error_with_its_line() -> None:
    with pytest.raises(ScenarioError, match=r"^mine\.toml:1: not TOML: "):
        parse_scenario("runs = [", "mine.toml")


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(
        ScenarioError, match=r"nowhere\.toml: no such file and no such example; the examples are case, d"
    ):
        load_scenario(tmp_path / "nowhere.toml")
    with pytest.raises(ScenarioError, match="cannot be read: Is a directory"):
        load_scenario(tmp_path)
    (tmp_path / "latin").write_bytes(b"name = '\xe4'")
    with pytest.raises(ScenarioError, match="not a UTF-8 text file"):
        load_scenario(tmp_path / "latin")


def test_the_guide_s_files_can_be_run() -> None:
    guide = (Path(__file__).parents[2] / "docs" / "simulate.md").read_text(encoding="utf-8")
    rig, scenario = (part.split("```")[0] for part in guide.split("```toml\n")[1:])
    true = true_rig_from(tomllib.loads(rig))
    assert list(true.causes) == ["cv_leak", "cv_sensor_offset"]
    assert true.likely
    assert [run.label for run in parse_scenario(scenario, "guide").runs] == (
        ["sine", "chirp", "prbs_pressure", "profile"]
    )

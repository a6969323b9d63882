"""A researcher's own cause: from a file or a package, together with the catalogue, and in the simulation."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import command_line
import pytest

from flying_vines.config.config import default_text
from flying_vines.identification.case import read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.verdict import extended_rig
from flying_vines.physics import cause as own_causes
from flying_vines.physics import effects
from flying_vines.physics.cause import CauseError, read_causes
from flying_vines.physics.effects import add_causes, catalogue, cause_named
from flying_vines.physics.plant.true_rig import load_true_rig, true_rig_text
from flying_vines.physics.rig import RigError

EXAMPLE = Path(__file__).parents[2] / "examples" / "seam_leak.py"
RIG = """
[cv]
volume_L = 0.2
[causes.seam_leak]
sonic_conductance_SL_per_s_kPa = 2e-5
opens_at_kPa = 12
defined_in = "seam_leak.py"
"""
SCENARIO = """
[[runs]]
kind = "openings"
reservoir_kPa = 450
valves = [{ for_s = 2, evp = 1, until_kPa = 40 }, { for_s = 10 }, { for_s = 2, solenoid = true }]
"""


@pytest.fixture(autouse=True)
def same_catalogue() -> Iterator[None]:
    yield
    effects._added.clear()
    catalogue.cache_clear()


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    (tmp_path / "scenario.toml").write_text(SCENARIO, encoding="utf-8")
    return tmp_path


def simulated(files: Path, rig: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str]:
    scenario, out = files / "scenario.toml", files / rig.stem
    arguments = ["--rig", str(rig), "--scenario", str(scenario), "--out", str(out), *options]
    status, _, error = command_line.run(capsys, "simulate", *arguments)
    return status, error


@pytest.mark.long
def test_a_file_is_simulated_found_written_and_simulated_again(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, given = files / "rig.toml", ("--cause", str(EXAMPLE))
    status, error = simulated(files, rig, capsys)
    assert (status, error.count("\n")) == (2, 1)
    assert "seam_leak.py, which is missing: add --cause seam_leak.py" in error
    assert simulated(files, rig, capsys, *given) == (0, "")

    case = read_case(files / "rig")
    suspects = ("seam_leak", "cv_leak", "orifice_leak", "viscous_leak", "dead_volume")
    verdict = diagnose(case, [cause_named(name) for name in suspects])
    assert verdict.cause == "seam_leak" and verdict.also == ()
    for name, value in (("opens_at_kPa", 12.0), ("sonic_conductance_SL_per_s_kPa", 2e-5)):
        found = verdict.parameters[name]
        assert found.low <= value <= found.high
        assert found.estimate == pytest.approx(value, rel=0.1)

    written = files / "extended.toml"
    written.write_text(true_rig_text(extended_rig(case.rig, verdict)), encoding="utf-8")
    assert load_true_rig(written).causes["seam_leak"]["opens_at_kPa"] == pytest.approx(12.0, rel=0.1)
    effects._added.clear()
    catalogue.cache_clear()
    with pytest.raises(RigError, match=r"add --cause seam_leak\.py"):
        load_true_rig(written)
    assert simulated(files, written, capsys, *given) == (0, "")


@pytest.mark.long
def test_the_command_searches_it_beside_the_catalogue(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert simulated(files, files / "rig.toml", capsys, "--cause", str(EXAMPLE))[0] == 0
    effects._added.clear()
    catalogue.cache_clear()
    arguments = [str(files / "rig"), "--cause", str(EXAMPLE), "--write-rig", str(files / "found.toml")]
    status, out, _ = command_line.run(capsys, "diagnose", *arguments)
    assert status == 0 and "A seam of the control volume opens under pressure." in out
    assert 'defined_in = "seam_leak.py"' in (files / "found.toml").read_text(encoding="utf-8")


def test_a_rig_file_names_the_file_that_is_missing(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, error = simulated(files, files / "rig.toml", capsys)
    assert (status, error.count("\n")) == (2, 1)
    assert "seam_leak.py, which is missing: add --cause seam_leak.py" in error
    add_causes(read_causes(EXAMPLE))
    # A cell of a notebook may run twice.
    add_causes(read_causes(EXAMPLE))
    assert [cause.name for cause in catalogue()].count("seam_leak") == 1
    written = true_rig_text(load_true_rig(files / "rig.toml"))
    assert 'defined_in = "seam_leak.py"' in written


def test_a_rig_file_names_a_file_with_an_apostrophe(files: Path) -> None:
    own = files / "o'brien's leak.py"
    own.write_text(EXAMPLE.read_text(encoding="utf-8"), encoding="utf-8")
    add_causes(read_causes(own))
    written = true_rig_text(load_true_rig(files / "rig.toml"))
    assert tomllib.loads(written)["causes"]["seam_leak"]["defined_in"] == own.name


def test_the_service_takes_a_rig_with_it(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config_file = files / "vine.toml"
    named = default_text().replace('rig = ""', 'rig = "rig.toml"')
    config_file.write_text(named, encoding="utf-8")
    status, _, error = command_line.run(capsys, "config", "check", str(config_file))
    assert (status, error.count("\n")) == (2, 1)
    assert "add --cause seam_leak.py" in error
    status, out, _ = command_line.run(capsys, "config", "check", str(config_file), "--cause", str(EXAMPLE))
    assert status == 0 and "used for cycles left: seam_leak" in out


GOOD = EXAMPLE.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("wrong", "line", "says"),
    [
        (GOOD.replace("def apply(rig,", "def apply(rig"), 7, "invalid syntax"),
        (GOOD.replace("return rig.with", "return ring.with"), 9, "'ring' is not defined"),
        (GOOD.replace("cv_orifice_leak=", "cv_orifice="), 9, "cv_orifice"),
        (GOOD.replace(", opens_at_kPa):", "):"), 7, "opens_at_kPa"),
        (GOOD.replace("return rig.", "rig."), 7, "must return the changed rig"),
        (GOOD.replace("seeds=(10.0,)", "seeds=(50.0,)"), 20, "seeds between low and high"),
        (GOOD.replace('"seam_leak"', '"seam leak"'), 13, "not a name of a cause"),
        (GOOD.replace("CAUSE = Cause(", "CAUSE = dict("), None, "defines no cause"),
        (GOOD.replace('"seam_leak"', '"cv_leak"'), None, "cv_leak is taken"),
        ("import no_such_module", 1, "no_such_module"),
    ],
)
def test_an_error_in_the_file_is_one_line_with_its_place(
    files: Path, capsys: pytest.CaptureFixture[str], wrong: str, line: int | None, says: str
) -> None:
    mine = files / "mine.py"
    mine.write_text(wrong, encoding="utf-8")
    status, error = simulated(files, files / "rig.toml", capsys, "--cause", str(mine))
    assert (status, error.count("\n")) == (2, 1)
    assert (f"mine.py:{line}:" if line else "mine.py: ") in error and says in error


def test_an_error_at_some_values_only_is_reported_with_the_values(tmp_path: Path) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(
        GOOD.replace("    seam =", "    assert opens_at_kPa < 20.0, 'too stiff'\n    seam ="),
        encoding="utf-8",
    )
    (cause,) = read_causes(mine)
    with pytest.raises(CauseError, match=r"mine.py:8: AssertionError: too stiff \(at .*opens_at_kPa = 30"):
        cause.put_into(effects.setup(load_true_rig(_nominal(tmp_path)).nominal), {"opens_at_kPa": 30.0, C: 1})


C = "sonic_conductance_SL_per_s_kPa"


def _nominal(folder: Path) -> Path:
    (folder / "nominal.toml").write_text("[cv]\nvolume_L = 0.2\n", encoding="utf-8")
    return folder / "nominal.toml"


def test_an_installed_package_adds_its_causes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "lab_causes.py").write_text(GOOD, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    points = [EntryPoint("seam_leak", "lab_causes:CAUSE", own_causes.ENTRY_POINTS)]
    monkeypatch.setattr(own_causes, "entry_points", lambda group: points if group == points[0].group else [])
    catalogue.cache_clear()
    assert cause_named("seam_leak").what.startswith("A seam")
    with pytest.raises(CauseError, match="seam_leak is taken"):
        add_causes(read_causes(EXAMPLE))
    points[0] = EntryPoint("seam_leak", "lab_causes:MISSING", own_causes.ENTRY_POINTS)
    catalogue.cache_clear()
    with pytest.raises(CauseError, match="cause seam_leak: AttributeError"):
        catalogue()

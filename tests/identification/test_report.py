"""The report: one self-contained page with the content of the verdict; names in a case are escaped."""

from __future__ import annotations

import base64
import json
import re
import subprocess
import sys
import warnings
from contextlib import redirect_stdout
from dataclasses import replace
from html.parser import HTMLParser
from io import StringIO
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import refused
from hidden_truth import draw

from flying_vines.cli.main import main
from flying_vines.identification.case import Case, read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.report import figures, page, svg
from flying_vines.identification.report.figures import curve, draw_ranking, shown_runs
from flying_vines.identification.report.readings import draw_residuals, draw_run
from flying_vines.identification.show import in_words, label_and_unit, numbers, share
from flying_vines.identification.verdict import (
    NONE,
    UNEXPLAINED,
    Named,
    ParameterEstimate,
    Remainder,
    Verdict,
)
from flying_vines.physics.effects import catalogue

HOSTILE = """<script>alert("1")</script><img src=http://example.org/x> & '$x_{'"""
VOID = {"meta", "img", "br"}
SVG = b"<svg xmlns='http://www.w3.org/2000/svg'/>"


class Diagnosed(NamedTuple):
    case: Case
    verdict: Verdict


def diagnosed(case: Case, *names: str) -> Diagnosed:
    return Diagnosed(case, diagnose(case, [cause for cause in catalogue() if cause.name in names]))


@pytest.fixture(scope="module")
def found(short_case: Case) -> Diagnosed:
    return diagnosed(short_case, "dead_volume", "cv_compliance", "evp_lag")


@pytest.fixture(scope="module")
def nothing(found: Diagnosed) -> Diagnosed:
    """A verdict in which the baseline explains everything."""
    evidence = found.verdict.evidence
    runs = tuple(replace(run, baseline_kPa=run.extended_kPa) for run in evidence.runs)
    errors = replace(found.verdict.held_out, nrmse_before=found.verdict.held_out.nrmse_after, gain=(0.0, 0.0))
    seen = replace(evidence, runs=runs, before=evidence.after, profiles=())
    verdict = replace(
        found.verdict,
        cause=NONE,
        parameters={},
        numbers={"reservoir.volume_L": 0.99 * found.case.rig.reservoir.volume_L},
        held_out=errors,
        evidence=seen,
    )
    return Diagnosed(found.case, verdict)


@pytest.fixture(scope="module")
def unexplained(found: Diagnosed) -> Diagnosed:
    """A verdict with residuals above noise."""
    return Diagnosed(
        found.case,
        replace(
            found.verdict,
            cause=UNEXPLAINED,
            parameters={},
            remainder=Remainder(0.07, "reservoir: time since the solenoid closed"),
            next_experiment="Repeat it with one valve at a time.",
        ),
    )


class Page(HTMLParser):
    """The page in a browser: its text, its requests, and unclosed tags."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.links: list[str] = []
        self.pictures: dict[str, str] = {}
        self.words: list[str] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "action")]
        assert not any(name.startswith("on") for name, _ in attrs)
        if tag == "img":
            self.pictures[dict(attrs)["alt"] or ""] = dict(attrs)["src"] or ""

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        self.words.append(" ")

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join("".join(self.words).split())


def read(path: Path) -> Page:
    return Page(path.read_text(encoding="utf-8"))


def page_of(diagnosed: Diagnosed, *pictures: str) -> Page:
    """The page with these pictures (default: placeholders for all of them)."""
    names = pictures or figures(diagnosed.verdict)
    return Page(page(diagnosed.verdict, diagnosed.case, dict.fromkeys(names, SVG)))


@pytest.fixture(scope="module")
def written(found: Diagnosed, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The files of the command: the page that it names, and the others."""
    folder = tmp_path_factory.mktemp("out") / "new" / "report"
    folder.mkdir(parents=True)
    (folder / "report.html").write_text("an older report, " * 1_000_000)
    out = StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), pytest.raises(SystemExit) as exit_:
        patch.setattr("flying_vines.identification.diagnose.diagnose", lambda case, progress: found.verdict)
        main(["diagnose", str(found.case.path), "--out", str(folder)])
    assert exit_.value.code == 0
    (line,) = (line for line in out.getvalue().splitlines() if line.startswith("Report"))
    page = Path(line.removeprefix("Report").strip())
    return [page, *(path for path in sorted(folder.iterdir()) if path != page)]


def test_a_report_is_one_page_that_needs_no_network(written: list[Path]) -> None:
    html = written[0].read_text(encoding="utf-8")
    seen = Page(html)
    assert written[0].name == "report.html" and len(html) < 3e6
    assert "script" not in seen.tags and "link" not in seen.tags
    assert len(seen.links) > 5 and all(link.startswith("data:image/svg+xml;base64,") for link in seen.links)
    assert not re.search(r"url\(|@import", html)
    assert "default-src 'none'" in html
    assert all(seen.pictures)
    for source in seen.pictures.values():
        picture = ElementTree.fromstring(base64.b64decode(source.partition(",")[2]))
        hrefs = [
            value for part in picture.iter() for name, value in part.attrib.items() if name.endswith("href")
        ]
        assert all(value.startswith(("#", "data:image/png;base64,")) for value in hrefs)


def test_a_report_has_the_content_of_the_verdict(found: Diagnosed, written: list[Path]) -> None:
    verdict, text = found.verdict, read(written[0]).text
    assert verdict.cause == draw("short", 1).hidden[0].name
    assert in_words(verdict) in text and "workshop" in text
    for name, estimate in verdict.parameters.items():
        value, low, high = numbers(estimate)
        assert value in text and f"{low} … {high}" in text and label_and_unit(name)[0] in text
    errors = verdict.held_out
    assert all(share(e) in text for e in (errors.nrmse_before, errors.nrmse_after, errors.noise_floor))
    assert all(" + ".join(tried.causes) in text for tried in verdict.ranking)
    assert all(run.run in text for run in verdict.evidence.runs)


def test_the_best_candidate_is_named_without_a_share_if_the_baseline_diverged(unexplained: Diagnosed) -> None:
    ranking = tuple(tried for tried in unexplained.verdict.ranking if tried.causes)
    text = in_words(replace(unexplained.verdict, ranking=ranking))
    assert text == "No known cause explains the difference between data and simulation."


def test_several_causes_are_mostly_one_only_if_it_makes_half_of_the_error(found: Diagnosed) -> None:
    also = (
        Named("cv_heating", found.verdict.parameters, 0.09),
        Named("hose", found.verdict.parameters, 0.004),
    )
    main = found.verdict.cause
    mostly = replace(found.verdict, share=0.81, also=also, remainder=Remainder(0.07, "time"))
    assert in_words(mostly) == (
        f"Mostly {main} (81 %), then cv_heating (9 %), then hose (less than 1 %). 7 % of the error remains."
    )
    several = replace(mostly, share=0.12, remainder=None)
    assert in_words(several) == f"Several causes: {main} (12 %), cv_heating (9 %), hose (less than 1 %)."
    text = page_of(Diagnosed(found.case, several), "unseen", "run-1").text
    assert "Without this cause 12 % of the removed squared error comes back" in " ".join(text.split())
    assert "need not add up to 100 %" in " ".join(text.split())


def test_beside_the_page_are_the_verdict_and_the_pictures(found: Diagnosed, written: list[Path]) -> None:
    by_name = {path.name: path for path in written}
    assert set(written) == set(written[0].parent.iterdir())
    assert json.loads(by_name["verdict.json"].read_text()) == json.loads(json.dumps(found.verdict.as_json()))
    pictures = {name.removesuffix(".svg") for name in by_name if name.endswith(".svg")}
    assert pictures == set(figures(found.verdict)) > {"run-1", "residuals", "profiles", "likeness"}
    assert len(pictures) == len(read(written[0]).pictures)


def test_the_same_verdict_makes_the_same_bytes(found: Diagnosed, written: list[Path]) -> None:
    pictures = {path.stem: path.read_bytes() for path in written if path.suffix == ".svg"}
    assert page(found.verdict, found.case, pictures) == written[0].read_text(encoding="utf-8")
    again = figures(found.verdict)
    for name in ("run-1", "ranking"):
        assert svg(again[name]) == pictures[name]


def test_candidates_of_many_causes_leave_room_for_their_axis(found: Diagnosed) -> None:
    tried = found.verdict.ranking[0]
    names = [cause.name for cause in catalogue()][:9]
    many = replace(tried, named=tuple(Named(name, {}, None) for name in names))
    figure = draw_ranking(replace(found.verdict, ranking=(tried, many)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # Matplotlib's, if a label takes all the width.
        figure.draw_without_rendering()
    (axis,) = figure.axes
    assert axis.get_position().width > 0.3


def test_no_name_of_a_case_becomes_part_of_the_page(found: Diagnosed) -> None:
    evidence = found.verdict.evidence
    hostile = replace(
        found.verdict,
        remarks=(HOSTILE,),
        remainder=Remainder(0.07, HOSTILE),
        next_experiment=HOSTILE,
        evidence=replace(evidence, runs=tuple(replace(run, run=HOSTILE) for run in evidence.runs)),
    )
    case = replace(found.case, path=Path(HOSTILE.replace("/", "")))
    seen = page_of(Diagnosed(case, hostile), "unseen", "run-1", "residuals")
    assert "script" not in seen.tags
    assert all(link.startswith("data:image/svg+xml;base64,") for link in seen.links)
    assert seen.text.count('<script>alert("1")</script>') >= 4


def test_a_baseline_that_explains_all_has_no_profiles_and_no_extended_model(nothing: Diagnosed) -> None:
    seen = page_of(nothing)
    assert in_words(nothing.verdict) in seen.text
    assert "Profiles of χ²" not in seen.pictures and "How well the data determine" not in seen.text
    assert "extended" not in seen.text
    assert "noise alone gives this" in seen.text
    assert "(−1.00 %)" in seen.text and "nominal" in seen.text


def test_a_rig_number_of_zero_stays_nominal(nothing: Diagnosed) -> None:
    rig = replace(nothing.case.rig, venturi=replace(nothing.case.rig.venturi, full_vacuum_kPa=0.0))
    verdict = replace(nothing.verdict, numbers={"venturi.full_vacuum_kPa": 0.0})
    seen = page_of(Diagnosed(replace(nothing.case, rig=rig), verdict))
    assert "full vacuum, kPa 0 ± 1 % nominal" in seen.text


def test_the_unexplained_remainder_comes_first(unexplained: Diagnosed) -> None:
    verdict = unexplained.verdict
    text = page_of(unexplained, "unseen", "run-1").text
    front = text[: text.index("Measured and simulated")]
    assert in_words(verdict) in front
    assert verdict.remainder is not None and verdict.remainder.depends_on in front
    assert verdict.next_experiment in front
    assert "not measurements" in front
    _, low, high = numbers(next(iter(verdict.ranking[0].named[0].parameters.values())))
    assert f"{low} … {high}" not in front


def test_a_discharge_has_one_channel(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 12.0, 0.1)
    leaking_kPa = 600.0 * np.exp(-time_s / 25.0) + np.random.default_rng(1).normal(0.0, 1.0, len(time_s))
    rows = "\n".join(f"{t:.2f},{p:.2f}" for t, p in zip(time_s, leaking_kPa, strict=True))
    (tmp_path / "rig.toml").write_text("[sensors]\nreservoir_noise_std_kPa = 1.0\n")
    (tmp_path / "reservoir.csv").write_text(f"time_s,reservoir_pressure_kPa\n{rows}\n")
    seen = diagnosed(read_case(tmp_path), "evp_restriction", "reservoir_leak", "cv_leak")
    report = page_of(seen)
    assert {"evp_restriction", "reservoir_leak"} & {seen.verdict.cause, *seen.verdict.indistinguishable}
    assert "0 + 120" in report.text and "reservoir volume, L" in report.text
    assert "Run 1: pressures and openings over time" in report.pictures


@pytest.mark.parametrize("row", [0, 1])
def test_a_channel_that_was_not_read_is_not_drawn(found: Diagnosed, row: int) -> None:
    runs = []
    for run in found.verdict.evidence.runs:
        measured_kPa = run.measured_kPa.copy()
        measured_kPa[row] = np.nan
        runs.append(replace(run, measured_kPa=measured_kPa))
    verdict = replace(found.verdict, evidence=replace(found.verdict.evidence, runs=tuple(runs)))
    drawn = draw_residuals(verdict), draw_run(verdict.evidence.runs[0], verdict.evidence.noise_kPa, "")
    titles = [axis.get_title() + axis.get_title(loc="left") for figure in drawn for axis in figure.axes]
    channel, other = ("control volume", "reservoir")[:: -1 if row else 1]
    assert any(title.startswith(other) for title in titles)
    assert not any(title.startswith(channel) for title in titles)
    assert "Measured minus simulated" in page_of(Diagnosed(found.case, verdict), "residuals").text


def test_of_many_runs_those_are_drawn_in_which_the_models_part_most(found: Diagnosed) -> None:
    evidence = found.verdict.evidence
    (run,) = evidence.runs
    apart = [2.0, 0.0, 5.0, 1.0, 0.0, 3.0, 4.0, 0.5, 0.1]
    runs = tuple(replace(run, extended_kPa=run.baseline_kPa + kPa) for kPa in apart)
    verdict = replace(found.verdict, evidence=replace(evidence, runs=runs))
    assert shown_runs(verdict) == [0, 2, 3, 5, 6, 7]
    names = [f"run-{index + 1}" for index in shown_runs(verdict)]
    assert "Of 9 runs, these 6 are shown" in page_of(Diagnosed(found.case, verdict), *names).text


def test_a_run_of_few_samples_can_be_drawn(found: Diagnosed) -> None:
    evidence = found.verdict.evidence
    (run,) = evidence.runs
    few = slice(None, None, len(run.time_s) // 8)
    sparse = replace(
        run,
        time_s=run.time_s[few],
        measured_kPa=run.measured_kPa[:, few],
        baseline_kPa=run.baseline_kPa[:, few],
        extended_kPa=run.extended_kPa[:, few],
        openings=run.openings[:, few],
    )
    names = " + ".join(["reservoir_sensor_offset", "solenoid_slow_close", "compressible_flow"])
    figure = draw_run(sparse, evidence.noise_kPa, names)
    assert svg(figure)
    (legend,) = figure.legends
    assert legend.get_window_extent().x1 < figure.bbox.x1


def test_a_profile_goes_through_what_was_computed(found: Diagnosed) -> None:
    (profile,) = found.verdict.evidence.profiles
    value, above = curve(profile)
    assert np.interp(profile.value, value, above) == pytest.approx(profile.above, abs=0.05)
    assert above.min() == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize(
    ("estimate", "said"),
    [
        (ParameterEstimate(5.6238, 5.604, 5.643), ("5.624", "5.604", "5.643")),
        (ParameterEstimate(-0.0028, -0.0111, 0.0056), ("−0.0028", "−0.0111", "0.0056")),
        (ParameterEstimate(1230.4, 1200.0, 1290.0), ("1,230", "1,200", "1,290")),
        (ParameterEstimate(0.5, 0.5, 0.5), ("0.5", "0.5", "0.5")),
        (
            ParameterEstimate(9.327e6, 1.148e6, 7.58e7),
            tuple(
                f"{m}\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}10{e}"
                for m, e in (("9.33", "⁶"), ("1.15", "⁶"), ("7.58", "⁷"))
            ),
        ),
    ],
)
def test_numbers_have_the_digits_that_the_interval_leaves_them(
    estimate: ParameterEstimate, said: tuple[str, str, str]
) -> None:
    assert numbers(estimate) == said


def test_every_parameter_of_the_catalogue_has_a_label_without_its_unit() -> None:
    for cause in catalogue():
        for parameter in cause.parameters:
            label, unit = label_and_unit(parameter.name)
            assert label and "_" not in label and "kPa" not in label
            assert bool(unit) == parameter.name.endswith(("_kPa", "_s", "_L", "_SL", "_min"))


def test_a_folder_that_cannot_be_written_is_one_line(
    found: Diagnosed, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        assert str(folder) in refused(capsys, "diagnose", found.case.path, "--out", folder)


def test_a_verdict_needs_no_matplotlib() -> None:
    code = "import sys, flying_vines.identification.diagnose; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"

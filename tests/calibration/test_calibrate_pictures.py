"""The pictures and the page of a calibration."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from flying_vines.calibration.findings import Chart, Findings, MeasuredQuantity, Series
from flying_vines.calibration.page import page, pictures

X = np.linspace(0.0, 20.0, 40)
CHART = Chart(
    "levels",
    "Air against pressure",
    "vine, kPa gauge",
    "air, SL",
    (
        Series("95 %", "band", X, 0.009 * X, 0.011 * X),
        Series("measured", "points", X, 0.01 * X),
        Series("many", "points", np.tile(X, 50), np.tile(0.012 * X, 50)),
        Series("fit", "line", X, 0.01 * X),
    ),
    "A <note>.",
)


def test_each_chart_is_two_files_and_the_same_bytes_again(tmp_path: Path) -> None:
    (tmp_path / "again").mkdir()
    drawn = pictures((CHART,), tmp_path)
    assert pictures((CHART,), tmp_path / "again") == drawn
    assert (tmp_path / "levels.svg").read_bytes() == drawn["levels"]
    assert len(drawn["levels"]) < 200_000
    assert ElementTree.fromstring(drawn["levels"]).tag.endswith("svg")
    png = (tmp_path / "levels.png").read_bytes()
    assert png.startswith(b"\x89PNG")
    assert png == (tmp_path / "again" / "levels.png").read_bytes()


def test_the_page_holds_every_quantity_and_needs_no_network(tmp_path: Path) -> None:
    findings = Findings(
        (
            MeasuredQuantity(
                "cv_volume_L", "vine's <volume>", "L", 0.1043, 0.102, 0.1066, assumed=0.1, note="scales"
            ),
        ),
        charts=(CHART,),
    )
    text = page("Calibration of today", "calibrated", findings, pictures((CHART,), tmp_path))
    HTMLParser().feed(text)
    assert "vine&#39;s &lt;volume&gt;" in text
    assert "0.1043" in text
    assert "+4.3" in text
    assert "http" not in text.replace("http-equiv", "")

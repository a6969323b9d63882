"""The public Python interface: its names, its page, and lazy imports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from recorded_flight import one_bend

from docs.documented_commands import ROOT
from flying_vines import api
from flying_vines.record.reader import LogError

PAGE = ROOT / "docs" / "python.md"
TLOG = ROOT / "tests" / "data" / "recordings" / "px4_mission.tlog"


def rows() -> str:
    """The table of the page."""
    lines = [f"| `{name}` | {(getattr(api, name).__doc__ or '').splitlines()[0]} |" for name in api.__all__]
    return "\n".join(["| name | |", "| --- | --- |", *lines, ""])


def test_the_page_lists_every_name() -> None:
    assert PAGE.read_text(encoding="utf-8").endswith(rows())


def test_nothing_heavy_is_imported_before_it_is_used() -> None:
    heavy = ["numpy", "scipy", "numba", "matplotlib", "pymavlink"]
    code = f"import sys; from flying_vines import api; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.strip() == "[]"
    with pytest.raises(AttributeError, match="no_such"):
        _ = api.no_such


def test_a_tlog_becomes_arrays(tmp_path: Path) -> None:
    tables = api.read_tlog(TLOG)
    beats = tables["HEARTBEAT"]
    assert len(beats["unix_s"]) == len(beats["custom_mode"]) > 10
    assert (np.diff(beats["unix_s"]) >= 0.0).all()
    assert tables["BATTERY_STATUS"]["voltages"].shape == (len(tables["BATTERY_STATUS"]["unix_s"]), 10)
    with pytest.raises(LogError, match="no such file"):
        api.read_tlog(tmp_path / "none.tlog")
    (tmp_path / "empty.tlog").write_bytes(b"")
    with pytest.raises(LogError, match="no MAVLink message"):
        api.read_tlog(tmp_path / "empty.tlog")


def test_a_flight_becomes_arrays(tmp_path: Path) -> None:
    tables = api.read_flight(one_bend(tmp_path))
    telemetry = tables["phlosar/telemetry"]
    assert len(telemetry) > 5 and {len(column) for column in telemetry.values()} == {len(telemetry["unix_s"])}
    assert any(name.startswith("mavlink/in/") for name in tables)
    assert np.issubdtype(telemetry["unix_s"].dtype, np.floating)

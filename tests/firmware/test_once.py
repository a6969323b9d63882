"""An artefact that several tests need is built once."""

from __future__ import annotations

from pathlib import Path

import pytest

from .once import made_once


def test_it_is_made_once_and_again_after_a_failure(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    monkeypatch.setattr(tmp_path_factory, "getbasetemp", lambda: tmp_path)
    calls: list[Path] = []

    def fail(folder: Path) -> None:
        raise OSError

    with pytest.raises(OSError):
        made_once(tmp_path_factory, "thing", fail)
    made = [made_once(tmp_path_factory, "thing", calls.append) for _ in range(2)]
    assert calls == [made[0]] and made[0] == made[1]
    monkeypatch.setenv("PYTEST_XDIST_WORKER", "gw1")
    monkeypatch.setattr(tmp_path_factory, "getbasetemp", lambda: tmp_path / "popen-gw1")
    assert made_once(tmp_path_factory, "thing", calls.append) == made[0]
    assert len(calls) == 1

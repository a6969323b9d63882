"""Some flights of `benchmarks/cycles_left_reported.py`: leaks, cut-off moves, refills, losses, restarts."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.long
def test_no_prediction_leaps_past_another_without_an_event(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    judge = import_module("cycles_left_reported").judge
    outcomes = [judge(seed) for seed in range(60_000, 60_006)]
    assert [jump for outcome in outcomes for jump in outcome.jumps] == []
    assert sum(outcome.events.total() for outcome in outcomes) > 6

"""A calibration of a simulated rig is a flight that a replay repeats."""

from __future__ import annotations

import asyncio
import io
from pathlib import Path

from rich.console import Console

from flying_vines.calibration.plan import CalibrationRequest
from flying_vines.calibration.rig import UserConfiguration, calibrate_simulated
from flying_vines.calibration.terminal import CalibrationTerminal
from flying_vines.config import config as configuration
from flying_vines.record.reader import FlightLog
from flying_vines.service.persistent_state import PersistentState
from flying_vines.simulation.replay import replay_flight


def test_with_disarmed_pneumatics_it_moves_nothing_and_a_replay_agrees(tmp_path: Path) -> None:
    path = tmp_path / "vine.toml"
    path.write_text(configuration.default_text())
    user = UserConfiguration(path.read_text(), path, configuration.load(path))
    PersistentState.of(path, user.config).store_disarmed(True)
    request = CalibrationRequest(asks_angles=False, only=("levels",))
    terminal = CalibrationTerminal(Console(file=io.StringIO()), interactive=False)
    calibration = calibrate_simulated(user, request, tmp_path / "flights", terminal, None)
    run = asyncio.run(calibration)
    replayed = replay_flight(FlightLog(run.folder))
    assert not replayed.differences
    assert run.ended.outcome != "done"
    assert run.ended.sentence.endswith("was refused: the pneumatics are disarmed")

"""Files that other editors and other computers wrote, and computers without a clock."""

from __future__ import annotations

import codecs
import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from recorded_flight import one_bend

from flying_vines.config import config
from flying_vines.files.bounded import decoded
from flying_vines.gateway import page_token
from flying_vines.gateway.mqtt.broker import password
from flying_vines.physics.plant.true_rig import TrueRig, true_rig_text
from flying_vines.physics.rig import Rig
from flying_vines.record.reader import FlightLog, flights_in
from flying_vines.service.starting import read_inputs
from flying_vines.vehicle.mavlink.signing import read_key
from missions.waypoints import read_waypoints

EDITORS = {
    "plain": lambda text: text.encode(),
    "no end of line": lambda text: text.strip().encode(),
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
    "BOM": lambda text: codecs.BOM_UTF8 + text.encode(),
    "BOM and CRLF": lambda text: codecs.BOM_UTF8 + text.replace("\n", "\r\n").encode(),
    "UTF-16": lambda text: text.encode("utf-16"),
    "spaces": lambda text: text.replace("\n", " \t\n").encode(),
}


@pytest.mark.parametrize("editor", EDITORS)
@pytest.mark.parametrize("comment", ["", "# written by hand\n\n"])
def test_a_text_of_any_editor_is_read(editor: str, comment: str, tmp_path: Path) -> None:
    path = tmp_path / "text"
    path.touch(mode=0o600)

    def write(text: str) -> Path:
        path.write_bytes(EDITORS[editor](comment + text))
        return path

    mqtt = config.default().mqtt
    assert password(type(mqtt)(password_file=str(write("secret word\n")))) == "secret word"
    assert read_key(write("ab" * 32 + "\n")) == bytes.fromhex("ab" * 32)
    assert read_key(write("passphrase: vines fly\n")) == hashlib.sha256(b"vines fly").digest()
    assert page_token.read(write("abcd-efgh-ijkl-mnop\n")) == "abcd-efgh-ijkl-mnop"
    row = "0\t1\t0\t16\t0\t0\t0\t0\t47\t8\t9\t1\n"
    path.write_bytes(EDITORS[editor]("QGC WPL 110\n" + comment + row))
    assert len(read_waypoints(path)) == 1
    rig = true_rig_text(TrueRig(Rig()))
    path.write_bytes(EDITORS[editor](rig))
    of_the_rig = tmp_path / "vine.toml"
    of_the_rig.write_text(config.default_text().replace('rig = ""', 'rig = "text"'))
    assert read_inputs(of_the_rig).rig_text.split() == rig.split()
    assert "\r" not in decoded(path.read_bytes())


def test_the_last_flight_is_last_whatever_the_clock_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = one_bend(tmp_path)
    monkeypatch.setattr("time.strftime", lambda form, *at: "1970-01-01_00-00-30")
    second = one_bend(tmp_path)
    os.utime(second / "flight.mcap", (30.0, 30.0))
    assert flights_in(tmp_path) == [first, second]
    assert FlightLog(tmp_path / "last").folder == second
    third = one_bend(tmp_path)
    assert flights_in(tmp_path) == [first, second, third]


@pytest.mark.parametrize("ignored", [True, False])
def test_under_nohup_the_service_stays_when_the_terminal_closes(ignored: bool, tmp_path: Path) -> None:
    path = tmp_path / "vine.toml"
    path.write_text(config.default_text().replace("port = 8017", "port = 0"))
    command = [sys.executable, "-m", "flying_vines", "run", "--config", str(path), "--out", str(tmp_path)]
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)
    try:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert process.stdout is not None
    while "link:" not in process.stdout.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGHUP)
    time.sleep(1.0)
    if ignored:
        assert process.poll() is None
        process.terminate()
    out, _ = process.communicate(timeout=20)
    assert "Vented. Stopped." in out
    assert "Traceback" not in out
    assert process.returncode == 0

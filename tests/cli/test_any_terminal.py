"""Every command on any terminal: its encoding, closed and full outputs, readers that are gone, and Ctrl-C."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time

import pytest
from docs.references import commands

PROGRAM = shlex.join((sys.executable, "-m", "flying_vines"))
OUTPUTS = {">&-": 0, "<&-": 0, ">/dev/full": 2, "| true": 0, "2>&- >&- <&-": 0}


@pytest.mark.long
@pytest.mark.parametrize("name", commands())
def test_every_command_ends_in_order_whatever_its_output_is(name: str) -> None:
    for output, status in OUTPUTS.items():
        shell = f"{PROGRAM} {name} --help {output}; exit ${{PIPESTATUS[0]}}"
        done = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, check=False)
        assert done.returncode == status, (output, done.stderr)
        assert "Traceback" not in done.stderr
        assert "Exception ignored" not in done.stderr


@pytest.mark.parametrize("name", ["", *(pytest.param(name, marks=pytest.mark.long) for name in commands())])
def test_any_encoding_takes_every_text(name: str) -> None:
    # An unknown argument with a letter that the terminal lacks: it comes back in the error.
    command = [*shlex.split(PROGRAM), *name.split(), "--höhe\udcff"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii:strict"}
    done = subprocess.run(command, capture_output=True, env=environment, check=False)
    assert done.returncode == 2
    assert done.stderr.isascii()
    assert b"Traceback" not in done.stderr


@pytest.mark.parametrize("after_s", [0.3, pytest.param(0.1, marks=pytest.mark.long), 0.6])
@pytest.mark.parametrize("name", ["watch", pytest.param("fake phlosar", marks=pytest.mark.long)])
def test_ctrl_c_is_status_130(name: str, after_s: float) -> None:
    command = [*shlex.split(PROGRAM), *name.split()]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    time.sleep(after_s)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    # On a busy computer it may come before the first line of ours, and Python shows a traceback of its own.
    before_us = "Traceback" in err and "flying_vines" not in err
    assert before_us or (process.returncode in (130, -signal.SIGINT) and "Traceback" not in err)


LOSES_CTRL_C = """
import signal, time
from flying_vines.cli import main

class Dropped:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def works(argv):
    Dropped()
    time.sleep(20.0)

main._run = works
main.main()
"""


def test_ctrl_c_that_python_drops_comes_again() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOSES_CTRL_C], capture_output=True, text=True, check=False, timeout=15
    )
    assert (done.returncode, done.stderr) == (130, "")

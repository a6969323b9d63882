"""Runs a command in this process and returns its exit status and output."""

from __future__ import annotations

import pytest

from flying_vines.cli.main import main


def status(*arguments: object) -> int:
    """The exit status of the command."""
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """The exit status, standard output and standard error of the command."""
    ended = status(*arguments)
    out, err = capsys.readouterr()
    return ended, out, err


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line with which a command ends at once: status 2, and nothing on standard output."""
    ended, out, line = run(capsys, *arguments)
    assert (ended, out, line.count("\n")) == (2, "", 1), line
    return line

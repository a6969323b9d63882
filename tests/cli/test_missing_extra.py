"""Without a package of the extra `analysis` a command says in one line what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("missing", "command"),
    [
        ("numpy", "design --out out"),
        ("matplotlib", "design --out out"),
        ("numpy", "vine fit p.csv"),
        ("scipy.optimize", "vine fit p.csv"),
        ("numpy", "simulate --rig r.toml --scenario case --out out"),
        ("matplotlib", "simulate --rig r.toml --scenario case --out out"),
        ("numpy", "paper"),
        ("matplotlib", "paper --out out"),
    ],
)
def test_a_missing_extra_is_one_line(missing: str, command: str, tmp_path: Path) -> None:
    code = f"import sys; sys.modules[{missing!r}] = None; from flying_vines.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, *command.split()],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"flying-vines: {missing} is missing: pip install 'flying-vines[analysis]'\n"
    assert list(tmp_path.iterdir()) == []

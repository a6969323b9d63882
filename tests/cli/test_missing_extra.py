"""Without a package of the extra `analysis` a command says in one line what to install."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from rich.console import Console

from flying_vines.files import extras
from flying_vines.files.extras import install_command


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
    assert done.stderr == f"flying-vines: {missing} is missing: {install_command('analysis')}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("sources", "wheel", "ends"),
    [
        (True, False, " -m pip install -e '{folder}[analysis]'"),
        (False, True, " -m pip install '{folder}/flying_vines-1-py3-none-any.whl[analysis]'"),
        (False, False, " 'numpy>=1.26' 'scipy>=1.11'"),
    ],
)
def test_the_remedy_fits_how_this_copy_was_installed(
    sources: bool, wheel: bool, ends: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Installed:
        def read_text(self, name: str) -> str:
            assert name == "direct_url.json"
            return f'{{"url": "{(tmp_path / "flying_vines-1-py3-none-any.whl").as_uri()}"}}'

    monkeypatch.setattr(extras, "SOURCES", tmp_path)
    monkeypatch.setattr(metadata, "distribution", lambda name: Installed())
    requires = ["rich>=13", 'numpy>=1.26; extra == "analysis"', "scipy>=1.11; extra == 'analysis'"]
    monkeypatch.setattr(metadata, "requires", lambda name: requires)
    if sources:
        (tmp_path / "pyproject.toml").touch()
    if wheel:
        (tmp_path / "flying_vines-1-py3-none-any.whl").touch()
    assert install_command("analysis").endswith(ends.format(folder=tmp_path))


def test_no_console_takes_brackets_for_markup() -> None:
    """A remedy, a path or a name in brackets must be printed as it is."""
    package = Path(extras.__file__).parents[1]
    made = re.compile(r"(?<![\w.])Console\((?!markup=False)")
    assert [
        path.name for path in package.rglob("*.py") if made.search(path.read_text(encoding="utf-8"))
    ] == []
    console = Console(markup=False, width=1000, record=True, file=io.StringIO())
    console.print(f"No picture: {install_command('analysis')}.")
    assert "[analysis]" in console.export_text()

"""The wheel and the sdist are complete, and the wheel runs without the sources."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterable
from email.parser import Parser
from importlib.metadata import distribution, packages_distributions
from pathlib import Path

import pytest
from docs.documented_commands import PAGES, blocks_and_spans
from docs.example_files import maker
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from required_programs import need

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
INSTALL = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
PACKAGES = ("firmware_link", "flying_vines", "missions")
FOLDERS = ("benchmarks", "docs", "examples", "tests")
OTHERS = (*FOLDERS, "LICENSE", "MANIFEST.in", "Makefile", "README.md", "pyproject.toml")
WITHOUT = """
import sys
sys.modules.update(dict.fromkeys({hidden}))
import flying_vines.cli.main, flying_vines.cli.link, flying_vines.service.runner
import flying_vines.simulation.demo, flying_vines.simulation.replay
import flying_vines.gateway.page.server
"""
"""Modules of these names cannot be imported."""
NEEDS_MORE = {
    r"demo --page|run|fake": "goes on until it is interrupted; tests/docs runs it",
    r"link|doctor --config": "needs a board, an autopilot and a pilot who moves the switch",
    r"mission upload": "needs an autopilot",
}
"""Our commands that do not run alone in an empty folder, and the reason."""
SNIPPET = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LITERAL = re.compile(r'"([\w./-]+)"')
ELSEWHERE = "import clr"
"""Marks a script for Mission Planner's own Python."""
NOT_SOURCES = shutil.ignore_patterns(".*", "__pycache__", "build", "*.egg-info")


def snippets(page: Path) -> list[str]:
    """The Python of a page. A snippet may use earlier ones."""
    return [code for code in SNIPPET.findall(page.read_text(encoding="utf-8")) if ELSEWHERE not in code]


def outcome(*command: str | Path, cwd: Path, **environment: str) -> str:
    """The output of a command that must succeed."""
    ran = subprocess.run(
        command,
        cwd=cwd,
        env=os.environ | {"TERM": "dumb", **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout
    return ran.stdout


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy, because a build leaves folders there."""
    copy = tmp_path_factory.mktemp("sources")
    for name in (*PACKAGES, *OTHERS):
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, copy / name, ignore=NOT_SOURCES)
        else:
            shutil.copy(path, copy / name)
    return copy


@pytest.fixture(scope="module")
def built(sources: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sdist, and the wheel that was built from the sdist."""
    pytest.importorskip("build", reason="needs build: pip install build")
    folder = tmp_path_factory.mktemp("dist")
    said = outcome(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, sources, cwd=folder)
    assert "SetuptoolsDeprecationWarning" not in said
    return folder


@pytest.fixture(scope="module")
def installed(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel in a folder of its own; the test environment provides its dependencies."""
    (wheel,) = built.glob("*.whl")
    folder = tmp_path_factory.mktemp("installed")
    pip = (sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
    outcome(*pip, "--no-index", "--no-deps", "--only-binary", ":all:", "--target", folder, wheel, cwd=folder)
    return folder


def files(root: Path, *folders: str) -> set[str]:
    found = (path for folder in folders for path in (root / folder).rglob("*"))
    return {str(path.relative_to(root)) for path in found if path.is_file()}


def test_the_wheel_holds_every_file_of_the_packages_and_no_other(sources: Path, built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    of_packages = {name for name in names if ".dist-info/" not in name}
    assert of_packages == files(sources, *PACKAGES)
    assert "flying_vines/config/default.toml" in of_packages
    assert "firmware_link/firmware/phlosar/phlosar.ino" in of_packages


def test_the_sdist_holds_the_tests_and_all_that_they_need(sources: Path, built: Path) -> None:
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = files(sources, *PACKAGES, "benchmarks", "docs", "tests") | {n for n in OTHERS if "." in n}
    assert wanted - names == set()


def test_the_service_needs_only_its_own_dependencies(built: Path, installed: Path) -> None:
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        wanted = Parser().parsestr(archive.read(metadata).decode()).get_all("Requires-Dist", [])
    declared = needed_by(wanted)
    assert "msgspec" in declared

    ours = declared | {"flying-vines"}
    hidden = {
        module
        for module, names in packages_distributions().items()
        if not ours & set(map(canonicalize_name, names))
    }
    assert "pytest" in hidden
    code = WITHOUT.format(hidden=sorted(hidden))
    outcome(sys.executable, "-c", code, cwd=installed, PYTHONPATH=str(installed))


def made_wheels(sources: Path, *settings: str) -> Path:
    """The folder that `make wheels` fills. Needs the package index."""
    make = need("make", "sudo apt install make")
    outcome(make, "wheels", f"VENV={sys.prefix}", *settings, cwd=sources)
    return sources / "wheels"


def test_wheels_for_a_drone_hold_all_that_each_of_its_pythons_needs(sources: Path) -> None:
    names = [path.name for path in made_wheels(sources).iterdir()]
    assert [name for name in names if not name.endswith(("-any.whl", "aarch64.whl"))] == []
    for package in ("msgspec", "numba", "pymavlink"):
        assert {tag for name in names for tag in re.findall(rf"^{package}-.*-(cp\d+)-", name)} == {
            "cp311",
            "cp313",
        }


def test_a_drone_without_network_is_installed_as_printed(sources: Path, tmp_path: Path) -> None:
    version = f"PYTHONS={sys.version_info.major}.{sys.version_info.minor}"
    made_wheels(sources, f"MACHINE={platform.machine()}", version, "EXTRAS=")
    for command in re.findall(r"^    sudo (.*(?:--without-pip|--find-links).*)$", INSTALL, re.MULTILINE):
        here = command.replace("python3 -m venv", f"{sys.executable} -m venv")
        outcome("sh", "-c", here.replace("/opt/flying-vines", str(tmp_path)), cwd=sources, PYTHONPATH="")
    outcome(tmp_path / "bin" / "flying-vines", "config", "init", "vine.toml", cwd=tmp_path, PYTHONPATH="")


def needed_by(wanted: Iterable[str]) -> set[str]:
    """The distributions that an installer brings for these, with all their dependencies."""
    found: set[str] = set()
    for requirement in map(Requirement, wanted):
        name = canonicalize_name(requirement.name)
        if name not in found and (requirement.marker is None or requirement.marker.evaluate({"extra": ""})):
            found |= {name} | needed_by(distribution(name).requires or [])
    return found


def test_the_checks_of_a_registry_pass(built: Path) -> None:
    pytest.importorskip("twine", reason="needs twine: pip install twine")
    outcome(sys.executable, "-m", "twine", "check", "--strict", *built.iterdir(), cwd=built)


def test_the_wheel_runs_where_the_sources_are_not(installed: Path, tmp_path: Path) -> None:
    python = {"PYTHONPATH": str(installed), "PYTHONSAFEPATH": "1"}
    where = "import flying_vines; print(flying_vines.__file__)"
    assert outcome(sys.executable, "-c", where, cwd=tmp_path, **python).startswith(str(installed))

    def flying_vines(*arguments: str) -> str:
        return outcome(sys.executable, "-m", "flying_vines", *arguments, cwd=tmp_path, **python)

    flying_vines("config", "init", "vine.toml")
    assert "good" in flying_vines("config", "check", "vine.toml")
    flying_vines("mission", "script", "--out", "vine.lua")
    flying_vines("install-service", "--root", "drone", "--yes")
    assert files(tmp_path, "drone") == {
        f"drone/etc/{path}"
        for path in (
            "flying-vines/vine.toml",
            "systemd/system/flying-vines.service",
            "sysusers.d/flying-vines.conf",
            "udev/rules.d/60-phlosar.rules",
        )
    }


@pytest.mark.parametrize("page", ["README.md", "docs/tutorial.md"])
def test_commands_run_as_printed_in_an_empty_folder(page: str, installed: Path, tmp_path: Path) -> None:
    python = {"PYTHONPATH": str(installed), "PYTHONSAFEPATH": "1", "HOME": str(tmp_path)}
    printed = [said.ours for said in blocks_and_spans(ROOT / page)[0] if said.ours]
    run = [words for words in printed if not re.match("|".join(NEEDS_MORE), " ".join(words))]
    assert run
    for words in run:
        outcome(sys.executable, "-m", "flying_vines", *words, cwd=tmp_path, **python)


@pytest.mark.parametrize("page", [page for page in PAGES if snippets(page)], ids=lambda page: page.name)
def test_snippets_run_as_printed_in_an_empty_folder(page: Path, installed: Path, tmp_path: Path) -> None:
    """All snippets of a page are one script; the files that it reads exist."""
    script = "".join(snippets(page))
    for word in LITERAL.findall(script):
        if (make := maker(word)) is not None:
            (tmp_path / word).parent.mkdir(parents=True, exist_ok=True)
            make(tmp_path / word)
    (tmp_path / "snippets.py").write_text(script, encoding="utf-8")
    outcome(sys.executable, "-P", "snippets.py", cwd=tmp_path, PYTHONPATH=str(installed))


def test_commands_that_do_not_run_are_still_on_a_page() -> None:
    pages = (ROOT / "README.md", ROOT / "docs/tutorial.md")
    printed = [" ".join(said.ours) for page in pages for said in blocks_and_spans(page)[0]]
    assert [pattern for pattern in NEEDS_MORE if not any(re.match(pattern, text) for text in printed)] == []

"""Every command of README.md and docs/ works.

A page's commands of ours are run in its order, in one folder. Those of `PARSED_ONLY` and behind a `sudo` are
only parsed: they take minutes or depend on the machine, and have tests of their own. Other programs are
not run; a test checks make's targets, the arguments of a benchmark, and the extras of pip.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from contextlib import redirect_stderr
from importlib.util import find_spec
from io import StringIO
from pathlib import Path

import pytest
from real_time import real_time

from docs.documented_commands import BEGINS, PAGES, ROOT, DocumentedCommand, blocks_and_spans, needs_a_shell
from docs.example_files import maker
from docs.references import commands
from docs.stage import LASTING, Ended, Stage
from flying_vines.cli.main import _parser

pytestmark = real_time

COMMANDS = commands()
PARSER = _parser()
ONCE = {*LASTING, "buttons", "design", "vine", "vine fit", "log plot", "log bundle"}
"""Commands without results for other commands: they run only once, even if another page repeats them."""
BY_MAVSDK = ("mission upload", "mission watch", "mission download")
SHELL = ("printf", "mkdir", "cd", "flying-vines")
"""The possible first words of a shell line."""
PARSED_ONLY = {"paper", "diagnose", "calibrate", "doctor"}
STATUS = {
    "flying-vines mission upload wrong.waypoints --link tcp:127.0.0.1:5760": 2,
    "flying-vines mission check canopy_sampling-px4.plan --autopilot ardupilot": 2,
}
"""Commands that fail on a page, with their exit status."""
MEANT = {
    r"--scenario case": "--scenario short.toml",
    r"--seconds \d+": "--seconds 1",
    r"--config FILE": "--config vine.toml",
    r"config check FILE": "config check vine.toml",
}
"""Replacements in a command: a file for a word in capitals, or less work."""


def commands_of(page: Path) -> Iterator[DocumentedCommand]:
    """A page's commands: all in its blocks, and the spans that are whole commands."""
    blocks, spans = blocks_and_spans(page)
    yield from blocks
    yield from filter(is_whole, spans)


def is_whole(span: DocumentedCommand) -> bool:
    """True if a span is a complete command; `flying-vines link` alone is a name."""
    words = span.text.split()
    if not BEGINS.match(span.text):
        return False
    if words[0] == "flying-vines":
        return words[1:] != name_of(words[1:]) and (needs_a_shell(span.text) or parses(span.ours))
    return len(words) > 2 or words[0] == "make"


def spoken_of(page: Path) -> Iterator[tuple[DocumentedCommand, list[str]]]:
    """Spans that name a command of ours, perhaps with an option, without being a complete command; with their
    words."""
    for span in blocks_and_spans(page)[1]:
        words = span.text.split()
        if words[0] == "flying-vines" and len(words) > 1 and not words[1].isupper():
            if not is_whole(span):
                yield span, words[1:]
        elif len(name := name_of(words)) > 1 or (name and any(word.startswith("--") for word in words)):
            yield span, words


def name_of(words: list[str]) -> list[str]:
    """The first words that are the name of a command of ours."""
    known = [name.split() for name in COMMANDS]
    return next((words[:n] for n in (2, 1) if any(words[:n] == name[:n] for name in known)), [])


def parses(words: list[str]) -> bool:
    """True if a command of ours accepts the words."""
    try:
        with redirect_stderr(StringIO()):
            PARSER.parse_args(words)
    except SystemExit:
        return False
    return True


def do(command: DocumentedCommand, stage: Stage, done: set[str]) -> None:
    """Run the command, or check what can be checked without running it. `Ended` says what is wrong."""
    text = meant(command.text)
    name = " ".join(name_of(command.ours))
    if name in ONCE and text in done:
        return
    if name in PARSED_ONLY or text.startswith("sudo ") or (name in BY_MAVSDK and not find_spec("mavsdk")):
        if command.ours and not parses(command.ours):
            raise Ended("its arguments are not what the parser takes")
    elif command.ours:
        stage.run(shlex.split(text)[1:], STATUS.get(text, 0))
    elif needs_a_shell(text) and text.split()[0] in SHELL:
        stage.shell(text)
    else:
        of_another_program(text, stage)
    done.add(text)


def meant(text: str) -> str:
    for pattern, instead in MEANT.items():
        text = re.sub(pattern, instead, text)
    return text


def of_another_program(text: str, stage: Stage) -> None:
    words = shlex.split(text)
    if words[0] == "make" and shutil.which("make"):
        until = words.index("&&") if "&&" in words else len(words)
        asked = subprocess.run(("make", "-n", *words[1:until]), cwd=ROOT, capture_output=True, text=True)
        if asked.returncode:
            raise Ended(asked.stderr)
    if words[1].startswith("benchmarks/"):
        stage.parse_only(words[1:])
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for extra in re.findall(r"(?:flying-vines|\.)\[(\w+)\]", text):
        if extra not in project["optional-dependencies"]:
            raise Ended(f"there is no extra {extra}")


@pytest.fixture(scope="module")
def done() -> set[str]:
    """Commands that have already run."""
    return set()


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_commands_of_a_page_work(page: Path, tmp_path: Path, done: set[str]) -> None:
    wrong = []
    kind = "px4" if "--autopilot px4" in page.read_text(encoding="utf-8") else "ardupilot"
    with Stage(tmp_path, maker, kind) as stage:
        for command in commands_of(page):
            try:
                do(command, stage, done)
            except Ended as error:
                wrong.append(f"{command}\n{error}")
    assert not wrong, "\n\n".join(wrong)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_commands_and_options_that_a_page_mentions_exist(page: Path) -> None:
    for span, words in spoken_of(page):
        name = " ".join(name_of(words))
        assert name, f"{span}: there is no such command"
        options = {word.partition("=")[0] for word in words if word.startswith("--")}
        known = set(COMMANDS[name]._option_string_actions) if name in COMMANDS else set()
        assert options <= known, f"{span}: {name} has no {', '.join(options - known)}"


@pytest.mark.long
def test_a_wrong_command_is_found(tmp_path: Path) -> None:
    wrong = ("flying-vines config check nowhere.toml", "flying-vines paper --outt DIR", "make nothing")
    with Stage(tmp_path, maker, "ardupilot") as stage:
        for text in (*wrong, "pip install 'flying-vines[nothing]'"):
            with pytest.raises(Ended):
                do(DocumentedCommand(ROOT / "README.md", 1, text, text), stage, set())


def test_commands_are_found_wherever_a_page_has_them(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE, encoding="utf-8")
    assert [(command.line, command.text) for command in commands_of(page)] == [
        (3, "flying-vines link --set a=1 --set b=2"),
        (8, "flying-vines log list"),
        (12, "flying-vines mission check FILE --fly"),
        (14, "flying-vines replay a.tlog"),
    ]
    assert [words for _, words in spoken_of(page)] == [["link"], ["run", "--rig"]]


PAGE = """
```sh
.venv/bin/flying-vines link --set a=1 \\
    --set b=2   # kept
```

```
$ flying-vines log list
2 flights
```

    flying-vines mission check FILE --fly

`flying-vines
replay a.tlog` is a command, `flying-vines link` and `run --rig` name some, `link = 1` does not.
"""


def test_every_replaced_command_is_still_on_a_page() -> None:
    texts = [command.text for page in PAGES for command in commands_of(page)]
    assert [pattern for pattern in MEANT if not any(re.search(pattern, text) for text in texts)] == []
    assert STATUS.keys() <= set(texts)

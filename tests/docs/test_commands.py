"""Every command of README.md and docs/ does what is said: it is run here, or it is known what else runs it.

A page's commands are run in its order, in one folder. A command that is new on a page is run without further
ado; where it cannot be, `accounted.py` says what else runs it, or why nothing does.
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

from docs.accounted import ACCOUNTED, MEANT, Accounted, Elsewhere, Ends, NotHere
from docs.commands_said import BEGINS, PAGES, ROOT, Said, bare, blocks_and_spans, needs_a_shell
from docs.references import commands
from docs.shelf import maker
from docs.stage import LASTING, Ended, Stage
from flying_vines.cli.main import _parser

pytestmark = real_time

COMMANDS = commands()
PARSER = _parser()
ONCE = {*LASTING, "buttons", "design", "vine", "vine fit", "log plot", "log bundle"}
"""Commands that leave nothing that others need: the same words on another page are not run again."""
BY_MAVSDK = ("mission upload", "mission watch", "mission download")
SHELL = ("printf", "mkdir", "cd", "flying-vines")
"""What a line for a shell may begin with here."""


def said(page: Path) -> Iterator[Said]:
    """A page's commands: all in its blocks, and the spans that are whole commands."""
    blocks, spans = blocks_and_spans(page)
    yield from blocks
    yield from filter(is_whole, spans)


def is_whole(span: Said) -> bool:
    """Whether one would type a span as it is; `flying-vines link` is the name of a command."""
    words = span.text.split()
    if not BEGINS.match(span.text):
        return False
    if words[0] == "flying-vines":
        return words[1:] != name_of(words[1:]) and (needs_a_shell(span.text) or parses(span.ours))
    return len(words) > 2 or words[0] == "make"


def spoken_of(page: Path) -> Iterator[tuple[Said, list[str]]]:
    """Spans that name a command of ours, perhaps with an option, and are no whole commands; their words."""
    for span in blocks_and_spans(page)[1]:
        words = span.text.split()
        if words[0] == "flying-vines" and len(words) > 1 and not words[1].isupper():
            if not is_whole(span):
                yield span, words[1:]
        elif len(name := name_of(words)) > 1 or (name and any(word.startswith("--") for word in words)):
            yield span, words


def name_of(words: list[str]) -> list[str]:
    """The words at the beginning that are the name of a command of ours."""
    known = [name.split() for name in COMMANDS]
    return next((words[:n] for n in (2, 1) if any(words[:n] == name[:n] for name in known)), [])


def parses(words: list[str]) -> bool:
    """Whether they are what a command of ours takes."""
    try:
        with redirect_stderr(StringIO()):
            PARSER.parse_args(words)
    except SystemExit:
        return False
    return True


def accounted(command: Said) -> str | None:
    """The key of what the table says of a command: its page and it, or it, or the longest that begins so."""
    text = command.text
    begins = [key for key in ACCOUNTED if key.endswith("…") and text.startswith(key.removesuffix("…"))]
    exact = [key for key in (f"{command.page.name}: {text}", text) if key in ACCOUNTED]
    return exact[0] if exact else max(begins, key=len, default=None)


def do(command: Said, stage: Stage, done: set[str]) -> None:
    """Run it, or see that it is accounted for; `Ended` says what is wrong."""
    key = accounted(command)
    known: Accounted | None = ACCOUNTED[key] if key else None
    text = meant(command.text)
    if isinstance(known, Elsewhere):
        is_there(command, known)
    elif isinstance(known, NotHere):
        could_be_run(command, stage)
    elif " ".join(name_of(command.ours)) in ONCE and text in done:
        return
    elif " ".join(name_of(command.ours)) in BY_MAVSDK and find_spec("mavsdk") is None:
        could_be_run(command, stage)
    elif command.ours:
        stage.run(shlex.split(text)[1:], known.status if isinstance(known, Ends) else 0)
    elif text.split()[0] in SHELL and needs_a_shell(text):
        stage.shell(text)
    else:
        raise Ended("nothing runs it: say in tests/docs/accounted.py which test does, or why none can")
    done.add(text)


def meant(text: str) -> str:
    for pattern, instead in MEANT.items():
        text = re.sub(pattern, instead, text)
    return text


def is_there(command: Said, elsewhere: Elsewhere) -> None:
    texts = [(ROOT / test).read_text(encoding="utf-8") for test in elsewhere.tests]
    options = [word for word in command.ours if word.startswith("--")]
    for wanted in elsewhere.has or (*name_of(command.ours), *options):
        if not any(wanted in text for text in texts):
            raise Ended(f"{' and '.join(elsewhere.tests)} should run it, but say nothing of {wanted}")


def could_be_run(command: Said, stage: Stage) -> None:
    """As far as can be seen without doing it."""
    words = shlex.split(command.text)
    if command.ours and not parses(command.ours):
        raise Ended("its arguments are not what the parser takes")
    if words[0] == "make" and shutil.which("make"):
        asked = subprocess.run(("make", "-n", *words[1:]), cwd=ROOT, capture_output=True, text=True)
        if asked.returncode:
            raise Ended(asked.stderr)
    if words[1].startswith("benchmarks/"):
        stage.parse_only(words[1:])
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for extra in re.findall(r"(?:flying-vines|\.)\[(\w+)\]", command.text):
        if extra not in project["optional-dependencies"]:
            raise Ended(f"there is no extra {extra}")


@pytest.fixture(scope="module")
def done() -> set[str]:
    """What was run already."""
    return set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_what_a_page_says_can_be_done(page: Path, tmp_path: Path, done: set[str]) -> None:
    wrong = []
    kind = "px4" if "--autopilot px4" in page.read_text(encoding="utf-8") else "ardupilot"
    with Stage(tmp_path, maker, kind) as stage:
        for command in said(page):
            try:
                do(command, stage, done)
            except Ended as error:
                wrong.append(f"{command}\n{error}")
    assert not wrong, "\n\n".join(wrong)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_what_may_be_left_out_may(page: Path) -> None:
    """Of a synopsis."""
    for command in said(page):
        shortest = bare(command.given)
        if shortest != command.given and command.ours:
            assert parses(shlex.split(shortest)[1:]), command


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_commands_and_options_that_a_page_speaks_of_are_there(page: Path) -> None:
    for span, words in spoken_of(page):
        name = " ".join(name_of(words))
        assert name, f"{span}: there is no such command"
        options = {word.partition("=")[0] for word in words if word.startswith("--")}
        known = set(COMMANDS[name]._option_string_actions) if name in COMMANDS else set()
        assert options <= known, f"{span}: {name} has no {', '.join(options - known)}"


def test_a_command_that_nothing_runs_is_told(tmp_path: Path) -> None:
    unknown = Said(ROOT / "README.md", 1, "rsync flights pi@drone:", "rsync flights pi@drone:")
    with Stage(tmp_path, maker, "ardupilot") as stage:
        with pytest.raises(Ended, match=r"say in tests/docs/accounted\.py which test does"):
            do(unknown, stage, set())
        with pytest.raises(Ended, match="ended with 2 instead of 0"):
            stage.run(["config", "check", "nowhere.toml"])


def test_commands_are_found_wherever_a_page_has_them(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE, encoding="utf-8")
    assert [(command.line, command.text) for command in said(page)] == [
        (3, "flying-vines link --set a=1 --set b=2"),
        (8, "flying-vines log list"),
        (12, "flying-vines mission check FILE --autopilot px4 --fly"),
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

    flying-vines mission check FILE [--autopilot px4|ardupilot] [--fly]

`flying-vines
replay a.tlog` is a command, `flying-vines link` and `run --rig` name some, `link = 1` does not.
"""


def test_what_is_accounted_for_is_still_said() -> None:
    all_said = [command for page in PAGES for command in said(page)]
    stale = set(ACCOUNTED) - {accounted(command) for command in all_said}
    assert not stale, f"on no page any more; take them out of tests/docs/accounted.py: {sorted(stale)}"
    unused = [
        pattern for pattern in MEANT if not any(re.search(pattern, command.text) for command in all_said)
    ]
    assert not unused, f"on no page any more; take them out of tests/docs/accounted.py: {unused}"

"""The optional packages of flying-vines, and the command that installs them into this copy of it."""

from __future__ import annotations

import json
import os
import re
import shlex
import sys
from collections.abc import Iterator
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urlsplit

SOURCES = Path(__file__).parents[2]


def lacks(error: ImportError) -> str:
    """The text for a missing package of the extra `analysis`, with the command that installs it."""
    return f"{error.name} is missing: {install_command('analysis')}"


def install_command(extra: str) -> str:
    """Works without a package index that has flying-vines: from the sources or the wheel, or by package."""
    rights = "" if os.access(sys.prefix, os.W_OK) else "sudo "
    python = shlex.quote(sys.executable)
    pip = f"{python} -m pip install" if find_spec("pip") else f"uv pip install --python {python}"
    if (SOURCES / "pyproject.toml").exists():
        wanted = ["-e", f"{SOURCES}[{extra}]"]
    elif wheel := _wheel():
        wanted = [f"{wheel}[{extra}]"]
    else:
        wanted = list(_packages(extra))
    return f"{rights}{pip} {shlex.join(wanted)}"


def _wheel() -> Path | None:
    """The wheel from which this copy was installed, if it is still there."""
    try:
        origin = metadata.distribution("flying-vines").read_text("direct_url.json") or "{}"
    except metadata.PackageNotFoundError:
        return None
    path = Path(unquote(urlsplit(json.loads(origin).get("url", "")).path))
    return path if path.suffix == ".whl" and path.exists() else None


def _packages(extra: str) -> Iterator[str]:
    for requirement in metadata.requires("flying-vines") or ():
        package, _, condition = requirement.partition(";")
        if re.search(rf"extra == ['\"]{extra}['\"]", condition):
            if own := re.match(r"flying-vines\[(\w+)\]", package):
                yield from _packages(own[1])
            else:
                yield package.strip()

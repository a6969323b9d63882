"""Measures the size and the order of the project at one or more revisions, as a Markdown table.

python benchmarks/house.py                  # the working tree
python benchmarks/house.py --at c772caf     # that revision, and the working tree
python benchmarks/house.py --at c772caf --write     # into docs/architecture.md
"""

from __future__ import annotations

import argparse
import ast
import re
import subprocess
import sys
import tarfile
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "architecture.md"
BLOCK = re.compile(r"(?<=<!-- house -->\n).*?(?=<!-- end -->)", re.DOTALL)
PRODUCT = ("flying_vines", "firmware_link", "missions")
SOURCE = {".py", ".cpp", ".h", ".ino", ".s", ".ld", ".js", ".css", ".html", ".lua", ".toml", ".ini", ".j2"}


@dataclass(frozen=True)
class Tree:
    """The files of a revision, or of the working tree."""

    root: Path
    files: tuple[Path, ...]

    def sources(self, *folders: str, python: bool = False) -> list[Path]:
        suffixes = {".py"} if python else SOURCE
        return [path for path in self.files if path.parts[0] in folders and path.suffix in suffixes]

    def text(self, path: Path) -> str:
        return (self.root / path).read_text(encoding="utf-8")

    def lines(self, paths: Iterable[Path]) -> list[int]:
        return [self.text(path).count("\n") for path in paths]


def working_tree() -> Tree:
    listed = _git("ls-files", "--cached", "--others", "--exclude-standard").decode().splitlines()
    return Tree(ROOT, tuple(path for path in map(Path, listed) if (ROOT / path).is_file()))


def revision(name: str, folder: Path) -> Tree:
    """A revision's files, unpacked into a folder."""
    with tarfile.open(fileobj=BytesIO(_git("archive", name))) as archive:
        archive.extractall(folder, filter="data")
    return Tree(folder, tuple(path.relative_to(folder) for path in folder.rglob("*") if path.is_file()))


def _git(*words: str) -> bytes:
    done = subprocess.run(("git", *words), cwd=ROOT, capture_output=True)
    if done.returncode:
        sys.exit(f"house: git {words[0]}: {done.stderr.decode().strip()}")
    return done.stdout


def shared_names(tree: Tree) -> int:
    """The number of public class names of the product that several classes have."""
    names = Counter(
        node.name
        for path in tree.sources(*PRODUCT, python=True)
        for node in ast.parse(tree.text(path)).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    return sum(count > 1 for count in names.values())


def circular_imports(tree: Tree) -> int:
    """The number of imports from a room to another one that imports it back, directly or through others.

    If there are none, the rooms have an order in which every import goes down.
    """
    imports = [
        (_room(path), room) for path in tree.sources(*PRODUCT, python=True) for room in _used(tree, path)
    ]
    below: dict[str, set[str]] = {}
    for room, used in imports:
        below.setdefault(room, set()).add(used)
    reach = {room: _reached(room, below) for room in below}
    return sum(room != used and room in reach.get(used, ()) for room, used in imports)


def _room(path: Path) -> str:
    inner = path.with_suffix("").parts
    return inner[1] if inner[0] == "flying_vines" else inner[0]


def _used(tree: Tree, path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(tree.text(path))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            parent = ".".join(path.parts[: -node.level]) + "." if node.level else ""
            module = parent + node.module
            names = (
                [f"{module}.{alias.name}" for alias in node.names] if module == "flying_vines" else [module]
            )
        for name in names:
            parts = name.split(".")
            if parts[0] in PRODUCT:
                yield parts[1] if parts[0] == "flying_vines" and len(parts) > 1 else parts[0]


def _reached(start: str, below: dict[str, set[str]]) -> set[str]:
    found: set[str] = set()
    waiting = [start]
    while waiting:
        for room in below.get(waiting.pop(), set()) - found:
            found.add(room)
            waiting.append(room)
    return found


def words(tree: Tree) -> tuple[int, int]:
    """The number of words of the guides, in all and outside the generated tables.

    A word contains a letter or a digit.
    """
    guides = [path for path in tree.files if path.parts[0] in ("docs", "README.md") and path.suffix == ".md"]
    texts = [tree.text(path) for path in guides]
    by_hand = [re.sub(r"<!-- (?!end).*?<!-- end -->", "", text, flags=re.DOTALL) for text in texts]
    total, written = (
        sum(bool(re.search(r"\w", word)) for text in some for word in text.split())
        for some in (texts, by_hand)
    )
    return total, written


def measured(tree: Tree) -> dict[str, str]:
    product = tree.sources(*PRODUCT, python=True)
    lengths = tree.lines(product)
    longest = max(zip(lengths, product, strict=True))
    all_words, by_hand = words(tree)
    return {
        "product, Python: lines in files": _size(tree, product),
        "product, all sources": _size(tree, tree.sources(*PRODUCT)),
        "tests, Python": _size(tree, tree.sources("tests", python=True)),
        "benchmarks, Python": _size(tree, tree.sources("benchmarks", python=True)),
        "median module, lines": f"{median(length for length in lengths if length):g}",
        "longest module, lines": f"{longest[0]} (`{longest[1].name}`)",
        "public class names with two meanings": str(shared_names(tree)),
        "imports in circles between rooms": str(circular_imports(tree)),
        "guides: words": f"{all_words:,}",
        "guides: words outside generated tables": f"{by_hand:,}",
    }


def _size(tree: Tree, paths: list[Path]) -> str:
    return f"{sum(tree.lines(paths)):,} in {len(paths)}"


def table(columns: dict[str, dict[str, str]]) -> str:
    first = next(iter(columns.values()))
    rows = [["", *columns], ["---", *("---:" for _ in columns)]]
    rows += [[key, *(column[key] for column in columns.values())] for key in first]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--at", metavar="REV", action="append", default=[], help="a revision; may be repeated"
    )
    parser.add_argument("--write", action="store_true", help="write the table into docs/architecture.md")
    given = parser.parse_args()
    columns = {}
    for name in given.at:
        with tempfile.TemporaryDirectory() as folder:
            columns[f"before (`{name}`)" if len(given.at) == 1 else f"`{name}`"] = measured(
                revision(name, Path(folder))
            )
    columns["now"] = measured(working_tree())
    text = table(columns)
    print(text, end="")
    if given.write:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(BLOCK.sub(lambda _: text, page), encoding="utf-8")


if __name__ == "__main__":
    main()

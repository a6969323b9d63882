"""How big the project is, beside earlier revisions of it.

    python benchmarks/size.py [REVISION ...]

Code is what stays without blank lines, comments, docstrings and imports. A small module has 100 lines or
fewer and one importer. A number is an assignment of a number, or of an expression of numbers, to a name of a
module. Revisions are read with git.
"""

from __future__ import annotations

import ast
import io
import statistics
import subprocess
import sys
import tarfile
import tokenize
from collections import Counter
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from module_imports import imported, module_name

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = ("flying_vines", "firmware_link", "missions")
SMALL_LINES = 100
NOT_CODE = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.ENCODING, tokenize.ENDMARKER),
}

Sources = Mapping[PurePosixPath, str]
"""The text of each Python file, by its path in the repository."""


def of_revision(revision: str) -> Sources:
    archive = subprocess.run(["git", "archive", revision], cwd=ROOT, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        return {
            PurePosixPath(member.name): tar.extractfile(member).read().decode()  # type: ignore[union-attr]
            for member in tar
            if member.isfile() and member.name.endswith(".py")
        }


def of_work_tree() -> Sources:
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split()
    paths = (ROOT / name for name in listed)
    return {
        PurePosixPath(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for path in paths
        if path.exists()
    }


def code_lines(source: str) -> int:
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    lines = {
        line
        for token in tokens
        if token.type not in NOT_CODE
        for line in range(token.start[0], token.end[0] + 1)
    }
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str())) | ast.Import() | ast.ImportFrom():
                lines -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def _is_number(node: ast.expr) -> bool:
    if isinstance(node, ast.UnaryOp):
        return _is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) or _is_number(node.right)
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def numbers(source: str) -> int:
    return sum(
        isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and _is_number(node.value)
        for node in ast.parse(source).body
    )


def importers(product: Sources) -> Counter[str]:
    """How many other modules import each module, by its dotted name."""
    names = {module_name(path) for path in product}
    count: Counter[str] = Counter()
    for path, source in product.items():
        count.update(imported(source, names) - {module_name(path)})
    return count


def figures(sources: Sources) -> dict[str, int]:
    product = {path: text for path, text in sources.items() if path.parts[0] in PRODUCT}
    modules = {path: text for path, text in product.items() if path.name != "__init__.py"}
    lines = {path: len(text.splitlines()) for path, text in product.items()}
    imported = importers(product)
    small = [path for path in modules if lines[path] <= SMALL_LINES and imported[module_name(path)] == 1]

    def lines_in(folder: str) -> int:
        return sum(len(text.splitlines()) for path, text in sources.items() if path.parts[0] == folder)

    return {
        "product: code": sum(map(code_lines, product.values())),
        "product: lines": sum(lines.values()),
        "product: files": len(product),
        "median module, lines": round(statistics.median(lines[path] for path in modules)),
        "small modules with one importer": len(small),
        "numbers of modules": sum(map(numbers, product.values())),
        "tests: lines": lines_in("tests"),
        "benchmarks: lines": lines_in("benchmarks"),
    }


def main() -> None:
    columns = {revision: figures(of_revision(revision)) for revision in sys.argv[1:]}
    columns["now"] = figures(of_work_tree())
    print(f"{'':32}" + "".join(f"{name[:12]:>13}" for name in columns))
    for row in columns["now"]:
        print(f"{row:32}" + "".join(f"{column[row]:>13,}" for column in columns.values()))


if __name__ == "__main__":
    main()

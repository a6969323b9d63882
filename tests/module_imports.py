"""Which modules of a project a module imports, from its source."""

from __future__ import annotations

import ast
from collections.abc import Collection
from pathlib import PurePath


def module_name(path: PurePath) -> str:
    """The dotted name of the module in a file; of a package for `__init__.py`."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(source: str, names: Collection[str]) -> set[str]:
    """Modules among `names` that the source imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module is not None
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in names else node.module)
    return found.intersection(names)

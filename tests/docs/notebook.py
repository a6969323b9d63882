"""Runs the notebook of docs/ without Jupyter and writes the output of its cells into it.

.venv/bin/python tests/docs/notebook.py
"""

from __future__ import annotations

import base64
import io
import json
import os
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).parents[2] / "docs" / "from_csv_to_simulation.ipynb"
DPI = 72


def read() -> dict[str, Any]:
    """The notebook: `nbformat` 4."""
    notebook: dict[str, Any] = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    return notebook


def code_cells(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run(notebook: dict[str, Any]) -> dict[str, object]:
    """Run all cells in the notebook's folder and replace their outputs. Returns the defined names."""
    os.environ["MPLBACKEND"] = "agg"
    import matplotlib.pyplot as plt

    names: dict[str, object] = {"__name__": "notebook"}
    with chdir(NOTEBOOK.parent):
        for number, cell in enumerate(code_cells(notebook), 1):
            printed = io.StringIO()
            with redirect_stdout(printed):
                exec(compile("".join(cell["source"]), f"cell {number}", "exec"), names)
            cell["outputs"] = []
            cell["execution_count"] = number
            if printed.getvalue():
                text = printed.getvalue().splitlines(keepends=True)
                cell["outputs"].append({"output_type": "stream", "name": "stdout", "text": text})
            for figure in map(plt.figure, plt.get_fignums()):
                image = io.BytesIO()
                figure.savefig(image, dpi=DPI, bbox_inches="tight", metadata={"Software": None})
                data = {"image/png": base64.b64encode(image.getvalue()).decode()}
                cell["outputs"].append({"output_type": "display_data", "data": data, "metadata": {}})
            plt.close("all")
    return names


def main() -> None:
    notebook = read()
    run(notebook)
    NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

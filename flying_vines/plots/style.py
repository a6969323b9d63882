"""How all pictures look."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

if "MPLBACKEND" not in os.environ:
    # A notebook has set it, and draws by itself; elsewhere pictures become files, with no window to open.
    matplotlib.use("Agg")
from matplotlib import pyplot as plt

BLUE, ORANGE, GREEN, PURPLE, RED, GREY = "#2563a8", "#d9730d", "#2f8f5b", "#7a4fb5", "#c4312f", "#8a8f98"
LABEL_BOX = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85}


def plain(axis: Any) -> None:
    """A quiet grid, and no box around."""
    axis.grid(color="#e6e8eb", lw=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def finish(figure: Any, title: str) -> Any:
    """The figure, with its title and plain axes."""
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    for axis in figure.axes:
        plain(axis)
    return figure


def save(figures: Mapping[str, Any], folder: Path, prefix: str) -> list[Path]:
    """Write each figure as `prefix-name.png` into a folder that exists, and close it: where they are."""
    paths = []
    for name, figure in figures.items():
        path = folder / f"{prefix}-{name}.png"
        figure.savefig(path, dpi=100)
        plt.close(figure)
        paths.append(path)
    return paths

"""The style of all figures."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

if "MPLBACKEND" not in os.environ:
    # A notebook sets its own backend. Elsewhere figures become files and need no window.
    matplotlib.use("Agg")
from matplotlib import pyplot as plt

BLUE, ORANGE, GREEN, PURPLE, RED, GREY = "#2563a8", "#d9730d", "#2f8f5b", "#7a4fb5", "#c4312f", "#8a8f98"
LABEL_BOX = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85}


def plain(axis: Any) -> None:
    """Give an axis a light grid and no box."""
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
    """Write each figure as `prefix-name.png` into an existing folder, and close it. Returns the paths."""
    paths = []
    for name, figure in figures.items():
        path = folder / f"{prefix}-{name}.png"
        figure.savefig(path, dpi=100)
        plt.close(figure)
        paths.append(path)
    return paths

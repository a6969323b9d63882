"""A verdict as one page that needs no network: figures, tables and text."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from platform import python_version
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from flying_vines.identification import show
from flying_vines.identification.candidate import CLAIM, STRUCTURE
from flying_vines.identification.case import Case
from flying_vines.identification.evidence import Compared
from flying_vines.identification.held_out import STRETCHES
from flying_vines.identification.intervals import ABOVE
from flying_vines.identification.report.figures import ALIKE, SEEN, alike_pairs, figures
from flying_vines.identification.report.readings import channels, models, residuals, same, strongest, typeset
from flying_vines.identification.residuals import CHANNELS, Pattern
from flying_vines.identification.search import CLAIM_LEFT, CLAIM_ON_BOUND
from flying_vines.identification.show import chance, in_words, labelled, signed
from flying_vines.identification.simulate import rig_number_keys
from flying_vines.identification.verdict import NONE, UNEXPLAINED, Verdict

__all__ = ["figures", "write_report"]

_CONSTANTS = {
    "ABOVE": ABOVE,
    "ALIKE": ALIKE,
    "CLAIM": CLAIM,
    "CLAIM_LEFT": CLAIM_LEFT,
    "CLAIM_ON_BOUND": CLAIM_ON_BOUND,
    "NONE": NONE,
    "STRETCHES": STRETCHES,
    "STRUCTURE": STRUCTURE,
    "UNEXPLAINED": UNEXPLAINED,
}
_LIBRARIES = ("flying-vines", "numpy", "scipy", "numba", "matplotlib")
TEMPLATES = Path(__file__).with_name("templates")
REPORT, VERDICT = "report.html", "verdict.json"
_DPI = 200
"""Resolution of the rasterized points; lines and text are vectors."""


def write_report(verdict: Verdict, case: Case, folder: Path) -> list[Path]:
    """Write a verdict into a folder, which is made if needed: the page, the verdict as JSON, and the figures.

    Args:
        verdict: the result of `diagnose(case)`.
        case: the data of the verdict.
        folder: gets `report.html`, which opens offline; `verdict.json`, the content of `diagnose --json`; and
            each of `figures` as an SVG file. Existing files of these names are replaced.

    Returns:
        the paths of the files, the page first. The same verdict gives the same bytes.
    """
    pictures = {name: svg(figure) for name, figure in figures(verdict).items()}
    content = {
        # The name of a file can contain bytes that are not text.
        REPORT: page(verdict, case, pictures).encode("utf-8", "replace"),
        VERDICT: json.dumps(verdict.as_json(), indent=2, allow_nan=False).encode() + b"\n",
        **{f"{name}.svg": svg for name, svg in pictures.items()},
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in content.items():
        (folder / name).write_bytes(data)
    return [folder / name for name in content]


def page(verdict: Verdict, case: Case, pictures: Mapping[str, bytes]) -> str:
    """The whole report.

    Args:
        pictures: SVG by the names of `figures`.
    """
    case_name, sentence = case.path.resolve().name, in_words(verdict)
    evidence, model = verdict.evidence, models(verdict)
    chosen = None if verdict.cause == UNEXPLAINED else {cause.cause for cause in verdict.named}
    similarity = evidence.similarity
    return filled(
        TEMPLATES / "report.html",
        pictures,
        **_CONSTANTS,
        verdict=verdict,
        model=model,
        title=f"{sentence} {case_name}",
        case_name=case_name,
        sentence=sentence,
        drawn_runs=sum(name.startswith("run-") for name in pictures),
        runs=[_run(run, verdict) for run in evidence.runs],
        noise=" and ".join(f"{CHANNELS[row]} {evidence.noise_kPa[row]:.3g} kPa" for row in channels(verdict)),
        chi2_per_reading=_chi2_per_reading(evidence.runs, verdict),
        patterns=[(pattern, _sizes(pattern, verdict)) for pattern in strongest(verdict)],
        ranking=[(tried, set(tried.causes) == chosen) for tried in verdict.ranking],
        alike=alike_pairs(similarity),
        unseen=[name for name, seen in zip(similarity.causes, similarity.seen, strict=True) if seen < SEEN],
        rig=list(_rig_rows(verdict, case)),
        versions=", ".join(
            [f"Python {python_version()}", *(f"{name} {version(name)}" for name in _LIBRARIES)]
        ),
    )


def _chi2_per_reading(runs: Sequence[Compared], verdict: Verdict) -> list[float]:
    """χ² per reading over both channels: of the baseline and, if there is one, of the extended model."""
    noise_kPa = verdict.evidence.noise_kPa
    both = np.concatenate([residuals(run, row, noise_kPa) for run in runs for row in (0, 1)], axis=1)
    return [float(np.nanmean(of_model**2)) for of_model in both[: 1 + bool(models(verdict))]]


def _run(run: Compared, verdict: Verdict) -> dict[str, Any]:
    return {
        "name": run.run,
        "seconds": run.time_s[-1] - run.time_s[0],
        "samples": len(run.time_s),
        "readings": np.isfinite(run.measured_kPa).sum(axis=1),
        "rms": [chi2**0.5 for chi2 in _chi2_per_reading([run], verdict)],
    }


def _sizes(pattern: Pattern, verdict: Verdict) -> list[tuple[str, str]]:
    """For each model: the largest mean residual of the pattern, and how often noise alone gives it."""
    sizes = []
    for patterns in (verdict.evidence.before, verdict.evidence.after)[: 1 + bool(models(verdict))]:
        found = same(pattern, patterns)
        largest = 0.0 if found is None else float(found.mean[np.argmax(np.abs(found.mean))])
        size = signed(f"{largest:+,.0f}" if abs(largest) >= 10.0 else f"{largest:+.2g}")
        sizes.append(("", "") if found is None else (size, chance(found)))
    return sizes


def _rig_rows(verdict: Verdict, case: Case) -> Iterator[tuple[str, str, str, str, str]]:
    """Group, label, nominal value, tolerance and fitted value of each rig number, then of the noise."""
    for key in rig_number_keys(case.rig):
        group, name = key.split(".")
        nominal = getattr(getattr(case.rig, group), name)
        fitted = "nominal"
        # A fit changes a number by a share of the number, so 0 stays 0.
        if key in verdict.numbers and nominal != 0.0:
            moved = signed(f"{100.0 * (verdict.numbers[key] / nominal - 1.0):+.2f}")
            fitted = f"{verdict.numbers[key]:,.5g} ({moved} %)"
        yield group, labelled(name), f"{nominal:,.5g}", f"± {case.rig.tolerance(key):g} %", fitted
    for group, used in zip(("cv", "reservoir"), verdict.evidence.noise_kPa, strict=True):
        if group == "reservoir" or case.rig.cv is not None:
            stated = getattr(case.rig.sensors, f"{group}_noise_std_kPa")
            fitted = "nominal" if used == stated else f"{used:.3g} in the data"
            yield group, "noise of its readings, kPa", f"{stated:g}", "", fitted


def filled(template: Path, pictures: Mapping[str, bytes], **content: Any) -> str:
    """A page that contains its pictures. Everything that comes from a case or a configuration is escaped.

    Args:
        template: may extend and include others from its folder and from `TEMPLATES`.
        pictures: SVG by name, for the macro `figure`.
        content: the other names of the template.
    """
    environment = Environment(
        autoescape=True,
        loader=FileSystemLoader([template.parent, TEMPLATES]),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {
        "keep_percent_on_line": lambda body: body.replace(" %", "\N{NO-BREAK SPACE}%"),
        "label_and_unit": show.label_and_unit,
        "number": format,
        "numbers": show.numbers,
        "rounded": show.rounded,
        "share": show.share,
    }
    shown = {name: f"data:image/svg+xml;base64,{b64encode(svg).decode()}" for name, svg in pictures.items()}
    return environment.get_template(template.name).render(pictures=shown, **content)


def svg(figure: Figure) -> bytes:
    """A figure as an SVG file, the same bytes each time."""
    with typeset(), BytesIO() as file:
        figure.savefig(file, format="svg", dpi=_DPI, metadata={"Date": None, "Creator": None})
        return file.getvalue()

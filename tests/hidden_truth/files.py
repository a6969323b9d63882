"""A case in the public format: `rig.toml` and a file for each run. The answer goes one level up."""

from __future__ import annotations

import json
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from hidden_truth.effects import Hidden
from hidden_truth.recording import CV_DECIMALS, RESERVOIR_DECIMALS, Recording, make
from hidden_truth.rig import rig_toml
from hidden_truth.truth import Truth

ANSWERS = "answers.json"


def answer(truth: Truth) -> dict[str, Any]:
    """The answer with which a verdict is compared; names and parameters as in the table of causes.

    `effect` is the largest one, `also` has the others; `share` is the part of the baseline's misfit that
    comes back without this effect; `nominal` has the rig's true numbers.
    """
    first, *others = truth.hidden or (None,)
    rig, shares = truth.rig, truth.shares
    return {
        "effect": "none" if first is None else first.name,
        "tier": truth.tier,
        "variant": truth.variant,
        "seed": truth.seed,
        "parameters": {} if first is None else _parameters(first),
        "share": shares[0] if shares else None,
        "also": [
            {"effect": one.name, "parameters": _parameters(one), "share": share}
            for one, share in zip_longest(others, shares[1:])
            if one
        ],
        "gap": truth.gap,
        "nominal": {
            "Vr": rig.reservoir_L,
            "Vcv": rig.cv_L,
            "R_evp": rig.evp_kPa_s_per_SL,
            "R_dvp": rig.dvp_kPa_s_per_SL,
            "R_sol": rig.solenoid_kPa_s_per_SL,
            "Pvac": rig.full_vacuum_kPa,
            "Pven": rig.rated_supply_kPa,
        },
    }


def _parameters(hidden: Hidden) -> dict[str, float]:
    return {hidden.effect.parameter: hidden.value}


def write(folder: Path, truth: Truth) -> dict[str, Any]:
    """Write the case into a new `folder`, and the answer beside it. Returns the answer."""
    folder.mkdir(parents=True)
    text = rig_toml(truth.assumed, truth.stated, truth.tolerance_percent)
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    for i, recording in enumerate(make(truth), start=1):
        (folder / f"run_{i}_{recording.name}.csv").write_text(csv_text(recording), encoding="utf-8")
    answers = folder.parent / ANSWERS
    known = json.loads(answers.read_text(encoding="utf-8")) if answers.exists() else {}
    known[folder.name] = answer(truth)
    answers.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    return answer(truth)


def csv_text(recording: Recording) -> str:
    """The recorded columns of a run."""

    def cell(value: float, form: str) -> str:
        return "" if np.isnan(value) else f"{value:{form}}"

    columns: dict[str, tuple[Any, str]] = {
        "time_s": (recording.time_s, ".3f"),
        "command_kPa": (recording.command_kPa, ".3f"),
        "evp_opening": (recording.inputs[:, 0], ".6g"),
        "dvp_opening": (recording.inputs[:, 1], ".6g"),
        "solenoid": (recording.inputs[:, 2], ".0f"),
        "cv_pressure_kPa": (recording.read[:, 0], f".{CV_DECIMALS}f"),
        "reservoir_pressure_kPa": (recording.read[:, 1], f".{RESERVOIR_DECIMALS}f"),
    }
    there = {name: column for name, column in columns.items() if name not in recording.missing}
    lines = [",".join(there)]
    for i in np.flatnonzero(recording.kept):
        lines.append(",".join(cell(values[i], form) for values, form in there.values()))
    return "\n".join(lines) + "\n"

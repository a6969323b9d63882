"""The flows of all causes, one after the other, compiled into one function with the simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isnan
from types import FunctionType
from typing import Any

from flying_vines.identification import model
from flying_vines.identification.cause import Cause
from flying_vines.identification.model import Array, Flows, Moment, Numbers
from flying_vines.physics.compiler import compiled

Function = Callable[..., Any]

first = 0
"""Where the parameters of this link's cause begin in `x`. Set, as the two functions, when compiled."""


def own(numbers: Numbers, moment: Moment, flows: Flows, x: Array) -> Flows:
    """What this link's cause does to the flows."""
    return flows


def others(numbers: Numbers, moment: Moment, flows: Flows, x: Array) -> Flows:
    """What the rest of the chain does."""
    return flows


def link(numbers: Numbers, moment: Moment, flows: Flows, x: Array) -> Flows:
    """A link of the chain; its cause is absent where its first parameter is NaN."""
    if isnan(x[first]):
        return others(numbers, moment, flows, x)
    return others(numbers, moment, own(numbers, moment, flows, x[first:]), x)


def compiled_run(causes: Sequence[Cause]) -> Callable[..., None]:
    """`model.run` with the flows of these causes; each finds its parameters in `x` in this order."""
    chain: Function = model.changed_flows
    at = 0
    for cause in causes:
        if cause.flows is not None:
            chain = _with(link, own=cause.flows, others=chain, first=at)
            at += len(cause.parameters)
    rates = _with(model.rates, changed_flows=chain)
    step = _with(model.step, rates=rates)
    careful_step = _with(model.careful_step, step=step)
    run: Function = compiled(_with(model.run, careful_step=careful_step), (step,))
    return run


def _with(function: Function, **instead: object) -> Function:
    """The function, to which other things go by these names."""
    assert isinstance(function, FunctionType)
    return FunctionType(function.__code__, {**function.__globals__, **instead}, function.__name__)

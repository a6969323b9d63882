"""The core's object code on emulated processors gives the same results as here, and is fast enough."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from required_programs import ARM_TOOLS, need

from .emulated import CHIPS, MADE, Chip, Instructions, Program, Run, build, results, run, trace
from .golden_frames import VECTORS, answers_in, frames, of_host_frame, to_device_frame
from .golden_run import PACKET, Part, Step, difference, read
from .once import made_once

PARTS = read()
STEPS = [step for part in PARTS for step in part.steps]
MAX_INSTRUCTIONS = {"m0plus": 12000, "m7": 6000}
"""Maximum in a control step: a quarter of a millisecond's cycles at 48 MHz, a hundredth of them at 600
MHz."""


@pytest.fixture(scope="module", params=CHIPS, ids=lambda chip: chip.name)
def program(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Program:
    for tool in ("make", "arm-none-eabi-g++", "qemu-system-arm"):
        need(tool, ARM_TOOLS)
    chip: Chip = request.param
    folder = made_once(tmp_path_factory, f"emulated-{chip.name}", lambda folder: build(chip, folder))
    return Program(chip, folder / MADE)


@pytest.fixture(scope="module")
def golden(program: Program, tmp_path_factory: pytest.TempPathFactory) -> Run:
    chip, told = program.chip, (one for part in PARTS for one in part.inputs)
    folder = made_once(tmp_path_factory, f"golden-{chip.name}", lambda folder: run(program, told, folder))
    return results(chip, folder)


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_the_chip_does_what_the_golden_run_holds(golden: Run, part: Part) -> None:
    before = sum(len(other.done) for other in itertools.takewhile(lambda other: other is not part, PARTS))
    done = (ticked.done for ticked in golden.ticked[before : before + len(part.done)])
    assert difference(part, done) == ""


def test_the_chip_answers_golden_frames_by_the_protocol(program: Program, tmp_path: Path) -> None:
    vectors = [bytes.fromhex(vector["frame_hex"]) for vector in VECTORS["frames"]]
    hosts = [of_host_frame(frame) for frame in vectors if frame_type(frame) < 0x80]
    devices = [to_device_frame(frame) for frame in vectors if frame_type(frame) > 0x80]
    conversations = [*hosts, *filter(None, devices)]
    ticked = iter(run(program, (one for c in conversations for one in c.inputs), tmp_path).ticked)
    for conversation in conversations:
        steps = sum(isinstance(one, Step) for one in conversation.inputs)
        *_, last = itertools.islice(ticked, steps)
        assert frames(answers_in(last.done)) == frames(conversation.answers)
    assert next(ticked, None) is None


def frame_type(frame: bytes) -> int:
    """No type is zero, so it is always the byte after the first code."""
    return frame[1]


def test_a_control_step_has_time_to_spare(program: Program, golden: Run) -> None:
    """The time includes the port's transfers: up to one frame."""
    assert len(golden.ticked) == len(STEPS)
    usual = [
        (ticked.instructions, step)
        for ticked, step in zip(golden.ticked, STEPS, strict=True)
        if step.received.count(0) <= 1 and max(len(step.received), step.fetched) <= PACKET
    ]
    assert len(usual) > 0.9 * len(STEPS)
    most, step = max(usual, key=lambda one: one[0].together)
    assert most.together < MAX_INSTRUCTIONS[program.chip.name], (most, step)


def test_instructions_are_counted_right(program: Program, golden: Run, tmp_path: Path) -> None:
    """The emulator's clock and a trace of each instruction agree, except for the cost of counting."""
    assert abs(golden.thousand - 1000) <= 3
    part = next(part for part in PARTS if part.name == "watchdog")
    counted = [ticked.instructions for ticked in run(program, part.inputs, tmp_path).ticked]
    operations = list(trace(program, part.inputs, tmp_path))
    assert [ticked.done for ticked in results(program.chip, tmp_path).ticked] == part.done
    assert [name for name, _ in operations] == list(Instructions._fields) * len(counted)
    beyond: dict[str, set[int]] = {name: set() for name in Instructions._fields}
    for clock, (name, addresses) in zip(itertools.chain(*counted), operations, strict=True):
        beyond[name].add(clock - len(addresses))
    # The same small number everywhere, so it contains nothing else.
    assert all(len(few) == 1 and 0 <= min(few) <= 16 for few in beyond.values()), beyond

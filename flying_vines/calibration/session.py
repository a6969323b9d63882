"""A calibration in real time: the service on the profile's ports, a recorder, and a person."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from flying_vines.calibration.calibrator import Calibrator, Question, Work
from flying_vines.calibration.conductor import (
    INTERRUPTED,
    STEP_S,
    VENTS_WITHIN_S,
    Beholder,
    Conducted,
    Conductor,
    began,
    done,
    vented,
)
from flying_vines.calibration.known import KnownBeforehand
from flying_vines.calibration.plan import CalibrationPlan
from flying_vines.core.events import Action, KeepDisarmed
from flying_vines.core.watcher import EachAction
from flying_vines.record.recorder import Recorder
from flying_vines.service.persistent_state import PersistentState, PersistentStateError
from flying_vines.service.service import Service
from flying_vines.vehicle.mavlink.signing_key import SigningKeyError, TimestampFile
from flying_vines.vehicle.notice import Severity
from flying_vines.vine.intent import Intent


class Person(Beholder, Protocol):
    """One who answers, too."""

    def ask(self, question: Question, answered: Callable[[str | None], None]) -> None:
        """`answered` is called once, now or later; None: nobody will answer."""


async def calibrate(
    plan: CalibrationPlan, known: KnownBeforehand, parent: Path, person: Person, stopped: asyncio.Event
) -> Conducted:
    """Calibrate the rig on the profile's ports; `stopped` ends it. However it ends, the vine is vented.

    The flight's folder is made in `parent`; `OSError` where that cannot be.
    """
    recorder = Recorder(parent, began(plan, known), plan.config.log.least_free_MB)
    calibrator = Calibrator(plan)
    tasks: set[asyncio.Task[None]] = set()

    def ask(intent: Intent) -> None:
        service.ask("calibration", intent)

    def question(asked: Question) -> None:
        def answered(text: str | None) -> None:
            conductor.carry_out(calibrator.answer(service.now, asked, text))

        person.ask(asked, answered)

    async def worked(asked: Work) -> None:
        result = await asyncio.to_thread(done, asked)
        conductor.carry_out(calibrator.worked(service.now, asked, result))

    async def keep(kept: PersistentState, disarmed: bool) -> None:
        try:
            await asyncio.to_thread(kept.store_disarmed, disarmed)
        except PersistentStateError as error:
            service.say(Severity.WARNING, f"disarming not kept: {error}")

    def take(action: Action) -> None:
        conductor.actions.append(action)
        if isinstance(action, KeepDisarmed) and known.kept is not None:
            # Of a calibration nothing else is kept, for its profile is none of the person's.
            tasks.add(asyncio.create_task(keep(known.kept, action.disarmed)))

    conductor = Conductor(
        calibrator, person, ask, question, lambda work: tasks.add(asyncio.create_task(worked(work)))
    )
    watchers = (recorder, EachAction(take))
    service = Service(plan.config, watchers, known.belief, disarmed=known.disarmed, signing=known.signing)
    serving = asyncio.create_task(service.run())
    try:
        conductor.carry_out(calibrator.begin(service.now))
        while calibrator.ended is None:
            await _pass(serving, tasks)
            if stopped.is_set():
                conductor.carry_out(calibrator.stop(service.now, INTERRUPTED))
            conductor.live(service.now, service.core.snapshot(service.now))
        until = service.now + VENTS_WITHIN_S
        while service.now < until and not vented(service.core.snapshot(service.now)):
            await _pass(serving, tasks)
    finally:
        service.stop()
        await serving
        if known.signing is not None and known.kept is not None:
            with suppress(SigningKeyError):
                TimestampFile(known.kept.signing_timestamp).save(known.signing.memory)
        recorder.close()
    return conductor.result(recorder.folder, recorder.news)


async def _pass(serving: asyncio.Task[None], tasks: set[asyncio.Task[None]]) -> None:
    """Let a step's time pass; raises what ended the service, or one of the tasks."""
    ended, _ = await asyncio.wait([serving, *tasks], timeout=STEP_S)
    for task in ended:
        task.result()
        tasks.discard(task)

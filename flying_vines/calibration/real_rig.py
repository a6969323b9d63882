"""A calibration of a real rig: the service on the configured ports, a recorder, and a person.

Nothing moves before the person agrees. At any end of the calibration, the vine is vented and the firmware's
telemetry rate is set back.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from firmware_link.protocol import Setting
from flying_vines.calibration.calibrator import Calibrator, EvaluationTask, Question
from flying_vines.calibration.configuration import proposed
from flying_vines.calibration.driver import (
    INTERRUPTED,
    LAST_VENT_S,
    STEP_S,
    CalibrationContext,
    CalibrationDriver,
    CalibrationOutcome,
    CalibrationRun,
    UserConfiguration,
    flight_start,
    load_context,
    planned,
    result_of,
)
from flying_vines.calibration.plan import CalibrationPlan, CalibrationRequest
from flying_vines.calibration.terminal import CalibrationTerminal
from flying_vines.config.address import Address, SerialAddress, parse_address
from flying_vines.core.events import Action, KeepDisarmed
from flying_vines.core.watcher import EachAction
from flying_vines.record.recorder import Recorder
from flying_vines.service.link_settings import SettingsError, exchange_settings
from flying_vines.service.persistent_state import PersistentState, PersistentStateError
from flying_vines.service.service import Service, on_stop_signals
from flying_vines.vehicle.mavlink.signing_key import SigningKeyError, TimestampFile
from flying_vines.vehicle.notice import Severity
from flying_vines.vine.intent import Intent

READY = (
    "The vine will bend: propellers off, nobody near it, nothing in its way, the bottle full.\n"
    "Press Enter to begin. Ctrl-C ends the calibration at any time and vents the vine."
)
RATE = "telemetry_Hz"
EVERY_STEP_HZ = 1000.0
"""Rate of the regulator's steps."""
MIN_BAUD = 460_800
"""Minimum baud rate for telemetry at `EVERY_STEP_HZ`."""


async def calibrate(
    user: UserConfiguration, request: CalibrationRequest, out: Path, terminal: CalibrationTerminal, save: bool
) -> CalibrationRun | None:
    """Calibrate the rig on the configured ports; None if the person does not agree.

    Raises `CalibrateError`, `SettingsError` if the board does not answer, the errors of `load_context`, or
    `OSError`.

    Args:
        save: save the proposed settings in the firmware.
    """
    config, context = load_context(user)
    plan = planned(config, request)
    address = parse_address(user.config.firmware.link)
    stopped = asyncio.Event()
    on_stop_signals(stopped.set)
    with terminal.typed():
        async with every_step(address, stopped, terminal.warn) as settings:
            terminal.introduce(plan)
            if not await terminal.confirmed(READY, stopped):
                return None
            with terminal.live():
                outcome = await _run(plan, context, out, terminal, stopped)
        wanted = proposed(outcome.findings.proposals, settings)
        saves = save and bool(wanted) and outcome.ended.outcome == "done"
        if saves:
            await exchange_settings(address, wanted, stopped, context.state)
    return CalibrationRun(outcome, config.pneumatics, stopped.is_set(), wanted, saves)


async def _run(
    plan: CalibrationPlan,
    context: CalibrationContext,
    parent: Path,
    terminal: CalibrationTerminal,
    stopped: asyncio.Event,
) -> CalibrationOutcome:
    """`stopped` ends the calibration.

    The flight's folder is made in `parent`. Raises `OSError` if that fails.
    """
    recorder = Recorder(parent, flight_start(plan, context), plan.config.log.least_free_MB)
    calibrator = Calibrator(plan)
    tasks: set[asyncio.Task[None]] = set()

    def ask(intent: Intent) -> None:
        service.ask("calibration", intent)

    def question(asked: Question) -> None:
        def answered(text: str | None) -> None:
            driver.carry_out(calibrator.answer(service.now, asked, text))

        terminal.ask(asked, answered)

    async def evaluate(task: EvaluationTask) -> None:
        result = await asyncio.to_thread(result_of, task)
        driver.carry_out(calibrator.evaluated(service.now, task, result))

    async def store(state: PersistentState, disarmed: bool) -> None:
        try:
            await asyncio.to_thread(state.store_disarmed, disarmed)
        except PersistentStateError as error:
            service.say(Severity.WARNING, f"disarming not saved: {error}")

    def take(action: Action) -> None:
        driver.actions.append(action)
        if isinstance(action, KeepDisarmed) and context.state is not None:
            # Parameters, learned air and faults are not stored: the service runs with the derived
            # configuration, not with the user's.
            tasks.add(asyncio.create_task(store(context.state, action.disarmed)))

    driver = CalibrationDriver(
        calibrator, terminal, ask, question, lambda task: tasks.add(asyncio.create_task(evaluate(task)))
    )
    watchers = (recorder, EachAction(take))
    service = Service(plan.config, watchers, context.prior, context.stored, context.signing)
    serving = asyncio.create_task(service.run())
    try:
        driver.carry_out(calibrator.begin(service.now))
        while calibrator.ended is None:
            await _pass(serving, tasks)
            if stopped.is_set():
                driver.carry_out(calibrator.stop(service.now, INTERRUPTED))
            driver.step(service.now, service.core.snapshot(service.now))
        until = service.now + LAST_VENT_S
        while service.now < until and not driver.vented(service.core.snapshot(service.now)):
            await _pass(serving, tasks)
    finally:
        service.stop()
        await serving
        if context.signing is not None and context.state is not None:
            with suppress(SigningKeyError):
                TimestampFile(context.state.signing_timestamp).save(context.signing.memory)
        recorder.close()
    return driver.outcome(recorder.folder, recorder.news)


async def _pass(serving: asyncio.Task[None], tasks: set[asyncio.Task[None]]) -> None:
    """Wait for one step at most. Raises the error that ended the service or one of the tasks."""
    ended, _ = await asyncio.wait([serving, *tasks], timeout=STEP_S)
    for task in ended:
        task.result()
        tasks.discard(task)


@asynccontextmanager
async def every_step(
    address: Address, stopped: asyncio.Event, warn: Callable[[str], None]
) -> AsyncIterator[Sequence[Setting]]:
    """In this context the firmware sends telemetry at `EVERY_STEP_HZ`, if the line is fast enough.

    Yields the firmware's settings. Raises SettingsError if no firmware answers, or once `stopped`. `warn`
    receives a sentence if the line is too slow, or if the rate cannot be set back.
    """
    known = await exchange_settings(address, {}, stopped)
    before_Hz = next(setting.value for setting in known if setting.name == RATE)
    if not carries_every_step(address):
        warn(
            f"a line below {MIN_BAUD} baud is too slow for telemetry at {EVERY_STEP_HZ:g} Hz: the rate stays "
            f"at {before_Hz:g} Hz, which is too slow for a diagnosis"
        )
        yield known
        return
    try:
        yield await exchange_settings(address, {RATE: EVERY_STEP_HZ}, stopped)
    finally:
        try:
            await exchange_settings(address, {RATE: before_Hz}, asyncio.Event())
        except SettingsError as error:
            warn(
                f"{RATE} is still {EVERY_STEP_HZ:g}, because it could not be set back: {error}. Later: "
                f"flying-vines link ADDRESS --set {RATE}={before_Hz:g}"
            )


def carries_every_step(address: Address) -> bool:
    """True if the port has a fast baud rate, or none that limits it (USB, pseudo-terminal, network)."""
    if not isinstance(address, SerialAddress) or address.baud >= MIN_BAUD:
        return True
    port = Path(address.path).resolve()
    return port.name.startswith("ttyACM") or port.parent == Path("/dev/pts")

"""A rig for the calibrator: a real one on the configured ports, or a simulated one in simulated time.

Both carry out the outputs of a calibrator in one loop, and record a flight. Nothing on a real rig moves
before the person agrees. At any end of the calibration, the vine is vented and the firmware's telemetry rate
is set back.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random

import msgspec

from firmware_link.protocol import Setting
from flying_vines.calibration.calibrator import (
    Calibrator,
    Ended,
    EvaluationTask,
    OperatorRequest,
    Output,
    Question,
)
from flying_vines.calibration.configuration import proposed
from flying_vines.calibration.findings import Findings
from flying_vines.calibration.plan import CalibrationPlan, CalibrationRequest, plan
from flying_vines.calibration.terminal import CalibrationTerminal
from flying_vines.config.address import Address, SerialAddress, parse_address
from flying_vines.config.config import Config, PneumaticsConfig
from flying_vines.config.config_text import configuration_text
from flying_vines.core.events import Action, Asked, Event, KeepDisarmed, Stop, StoredState, ToVehicle
from flying_vines.core.snapshot import Snapshot
from flying_vines.core.watcher import EachAction
from flying_vines.physics.plant.true_rig import load_true_rig
from flying_vines.record.recorder import FlightStart, Recorder
from flying_vines.service.link_settings import SettingsError, exchange_settings
from flying_vines.service.persistent_state import PersistentState, PersistentStateError
from flying_vines.service.service import Service, on_stop_signals
from flying_vines.service.starting import read_inputs
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedWorld
from flying_vines.supply import RigPrior
from flying_vines.vehicle.component.parameters import Parameters
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mavlink.signing import Signing, SigningKeyError, TimestampFile
from flying_vines.vehicle.notice import Severity
from flying_vines.vine.curve import BendCurve
from flying_vines.vine.intent import Intent

STEP_S = 0.02
LAST_VENT_S = 5.0
"""Maximum time to wait for the vent that ends a calibration, also an interrupted one."""
READY = (
    "The vine will bend: propellers off, nobody near it, nothing in its way, the reservoir full.\n"
    "Press Enter to begin. Ctrl-C ends the calibration at any time and vents the vine."
)
RATE = "telemetry_Hz"
EVERY_STEP_HZ = 1000.0
"""Rate of the regulator's steps."""
MIN_BAUD = 460_800
"""Minimum baud rate for telemetry at `EVERY_STEP_HZ`."""
STEPS_PER_SNAPSHOT = 5
CURVE = ((0.0, 0.0), (3.0, 0.0), (6.0, 17.0), (9.0, 30.0), (12.0, 40.0), (16.0, 50.0), (21.0, 58.0))
"""Bend curve of the simulated vine; it differs from the configured one."""
HYSTERESIS_KPA = 1.2
READING_SD_DEG = 1.0


class CalibrateError(Exception):
    """The request cannot be met; the text is one sentence."""


@dataclass(frozen=True)
class UserConfiguration:
    """The configuration of the rig."""

    text: str
    path: Path | None
    """None: the built-in configuration."""
    config: Config

    @property
    def name(self) -> str:
        return str(self.path or "the built-in configuration")


@dataclass(frozen=True)
class CalibrationRun:
    """A calibration that has ended."""

    folder: Path
    """Folder of the flight."""
    ended: Ended
    findings: Findings
    log_problem: str
    """One sentence if the log is incomplete: it ended, or it continues in another folder."""
    pneumatics: PneumaticsConfig
    """The rig file's numbers if the configuration names a rig file."""
    interrupted: bool
    firmware: Mapping[str, float] = field(default_factory=dict)
    """Proposed settings."""
    is_set: bool = False
    """True if the proposed settings are saved in the firmware."""

    @property
    def done(self) -> bool:
        return self.ended.outcome == "done"


@dataclass(frozen=True)
class _Prepared:
    """The plan for a configuration, and the state that `run` has stored for it."""

    plan: CalibrationPlan
    pneumatics: PneumaticsConfig
    prior: RigPrior | None
    rig_text: str
    """Content of the configuration's rig file."""
    stored: StoredState
    """Contains only whether the pneumatics are disarmed. The parameters are already in the configuration."""
    signing: Signing | None
    state: PersistentState | None

    def recorder(self, parent: Path, t: float | None = None) -> Recorder:
        """Makes the flight's folder in `parent`; a replay starts from its first entry. Raises `OSError`."""
        config = self.plan.config
        numbers = self.prior.pneumatics if self.prior else config.pneumatics
        start = FlightStart(configuration_text(config), numbers, self.rig_text, self.stored)
        return Recorder(parent, start, config.log.least_free_MB, t=t)


def _prepared(user: UserConfiguration, request: CalibrationRequest) -> _Prepared:
    """The configuration is used as `run` would use it: with the stored parameters and the rig file.

    Raises `ConfigError`, or `CalibrateError` if the request cannot be met.
    """
    config, prior, rig_text, stored, signing, state = user.config, None, "", StoredState(), None, None
    if user.path is not None:
        read = read_inputs(user.path)
        config = Parameters(read.config, read.stored.parameters).config
        if read.known:
            prior = read.known.prior
            config = msgspec.structs.replace(config, pneumatics=prior.pneumatics)
        stored = StoredState(disarmed=read.stored.disarmed)
        rig_text, signing, state = read.rig_text, read.signing, read.state
    try:
        planned = plan(config, request)
    except ValueError as error:
        raise CalibrateError(str(error)) from None
    return _Prepared(planned, config.pneumatics, prior, rig_text, stored, signing, state)


class _Rig(ABC):
    """Passes the core's actions to a calibrator, and carries out its outputs."""

    _world: Service | SimulatedWorld
    """Where the core runs."""

    def __init__(self, prepared: _Prepared, terminal: CalibrationTerminal, recorder: Recorder) -> None:
        self._prepared = prepared
        self._terminal = terminal
        self._recorder = recorder
        self._calibrator = Calibrator(prepared.plan)
        self._actions: deque[Action] = deque()
        """Not yet taken by the calibrator, in order."""
        self._outputs: deque[Output] = deque()
        """The first is being carried out."""

    async def calibrate(self, stopped: asyncio.Event) -> CalibrationRun:
        """Run the calibration until its end, or until `stopped`; then wait until the vine is vented."""
        calibrator = self._calibrator
        try:
            await self._pass_time()
            self._carry_out(calibrator.begin(self._now))
            while calibrator.ended is None:
                await self._pass_time()
                if stopped.is_set():
                    self._carry_out(calibrator.stop(self._now, "interrupted"))
                self._take_actions()
                self._carry_out(calibrator.tick(self._now, self._snapshot()))
                self._take_actions()
                self._terminal.progress(calibrator.progress)
            until = self._now + LAST_VENT_S
            while self._now < until and not calibrator.vented(self._snapshot()):
                await self._pass_time()
        finally:
            await self._close()
            self._recorder.close()
        return CalibrationRun(
            self._recorder.folder,
            calibrator.ended,
            calibrator.findings,
            self._recorder.news,
            self._prepared.pneumatics,
            stopped.is_set(),
        )

    def _take_actions(self) -> None:
        while self._actions:
            self._carry_out(self._calibrator.take(self._actions.popleft()))

    def _carry_out(self, outputs: Sequence[Output]) -> None:
        """Carry out outputs in order. Outputs that they cause come after them."""
        self._outputs.extend(outputs)
        if len(self._outputs) > len(outputs):
            return
        while self._outputs:
            match self._outputs[0]:
                case OperatorRequest(intent):
                    self._ask(intent)
                case Question() as question:
                    self._question(question)
                case EvaluationTask() as task:
                    self._evaluate(task)
                case shown:
                    self._terminal.show(shown)
            self._outputs.popleft()

    def _answer(self, question: Question, text: str | None) -> None:
        self._carry_out(self._calibrator.answer(self._now, question, text))

    def _evaluated(self, task: EvaluationTask, result: object) -> None:
        self._carry_out(self._calibrator.evaluated(self._now, task, result))

    @property
    def _now(self) -> float:
        return self._world.now

    def _snapshot(self) -> Snapshot:
        return self._world.core.snapshot(self._now)

    @abstractmethod
    async def _pass_time(self) -> None:
        """One step at most. Raises the error that ends the calibration."""

    @abstractmethod
    def _ask(self, intent: Intent) -> None: ...

    @abstractmethod
    def _question(self, question: Question) -> None: ...

    @abstractmethod
    def _evaluate(self, task: EvaluationTask) -> None: ...

    @abstractmethod
    async def _close(self) -> None: ...


def result_of(task: EvaluationTask) -> object:
    """The task's result, or its exception: a failed evaluation does not end the calibration."""
    try:
        return task.run()
    except Exception as error:
        return error


# A real rig.


async def calibrate_real(
    user: UserConfiguration, request: CalibrationRequest, out: Path, terminal: CalibrationTerminal, save: bool
) -> CalibrationRun | None:
    """Calibrate the rig on the configured ports; None if the person does not agree.

    Raises `CalibrateError`, `ConfigError`, `OSError`, or `SettingsError` if the board does not answer.

    Args:
        save: save the proposed settings in the firmware.
    """
    prepared = _prepared(user, request)
    address = parse_address(user.config.firmware.link)
    stopped = asyncio.Event()
    on_stop_signals(stopped.set)
    with terminal.typed():
        async with every_step(address, stopped, terminal.warn) as settings:
            terminal.introduce(prepared.plan)
            if not await terminal.confirmed(READY, stopped):
                return None
            with terminal.live():
                run = await _RealRig(prepared, terminal, prepared.recorder(out)).calibrate(stopped)
        wanted = proposed(run.findings.proposals, settings)
        saves = save and bool(wanted) and run.done
        if saves:
            await exchange_settings(address, wanted, stopped, prepared.state)
    return replace(run, interrupted=stopped.is_set(), firmware=wanted, is_set=saves)


class _RealRig(_Rig):
    """The service in this process. Evaluations run in threads, and a person answers."""

    def __init__(self, prepared: _Prepared, terminal: CalibrationTerminal, recorder: Recorder) -> None:
        super().__init__(prepared, terminal, recorder)
        watchers = (recorder, EachAction(self._take))
        self._world = self._service = Service(
            prepared.plan.config, watchers, prepared.prior, prepared.stored, prepared.signing
        )
        self._serving = asyncio.create_task(self._service.run())
        self._tasks: set[asyncio.Task[None]] = set()

    async def _pass_time(self) -> None:
        ended, _ = await asyncio.wait([self._serving, *self._tasks], timeout=STEP_S)
        for task in ended:
            task.result()
            self._tasks.discard(task)

    def _ask(self, intent: Intent) -> None:
        self._service.ask("calibration", intent)

    def _question(self, question: Question) -> None:
        self._terminal.ask(question, lambda text: self._answer(question, text))

    def _evaluate(self, task: EvaluationTask) -> None:
        async def evaluate() -> None:
            self._evaluated(task, await asyncio.to_thread(result_of, task))

        self._tasks.add(asyncio.create_task(evaluate()))

    def _take(self, action: Action) -> None:
        self._actions.append(action)
        if isinstance(action, KeepDisarmed) and self._prepared.state is not None:
            # Parameters, learned air and faults are not stored: the service runs with the derived
            # configuration, not with the user's.
            self._tasks.add(asyncio.create_task(self._store(self._prepared.state, action.disarmed)))

    async def _store(self, state: PersistentState, disarmed: bool) -> None:
        try:
            await asyncio.to_thread(state.store_disarmed, disarmed)
        except PersistentStateError as error:
            self._service.say(Severity.WARNING, f"disarming not saved: {error}")

    async def _close(self) -> None:
        self._service.stop()
        await self._serving
        signing, state = self._prepared.signing, self._prepared.state
        if signing is not None and state is not None:
            with suppress(SigningKeyError):
                TimestampFile(state.signing_timestamp).save(signing.memory)


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


# A simulated rig.


async def calibrate_simulated(
    user: UserConfiguration,
    request: CalibrationRequest,
    out: Path,
    terminal: CalibrationTerminal,
    rig: Path | None,
) -> CalibrationRun:
    """Calibrate the rig of a rig file; without a file, a rig with all typical effects.

    Raises `CalibrateError`, `ConfigError` or `OSError`.
    """
    if request.vessel_L is not None:
        raise CalibrateError("--vessel-L needs a person who changes a hose; it does not work with --fake")
    prepared = _prepared(user, request)
    phlosar = SimulatedPhlosar(
        load_true_rig(rig) if rig else None,
        {RATE: EVERY_STEP_HZ},
        reservoir_kPa=0.0 if request.reservoir_empty else prepared.pneumatics.full_kPa,
    )
    stopped = asyncio.Event()
    on_stop_signals(stopped.set)
    terminal.introduce(prepared.plan)
    with terminal.live():
        return await _SimulatedRig(prepared, terminal, prepared.recorder(out, t=0.0), phlosar).calibrate(
            stopped
        )


class _SimulatedRig(_Rig):
    """A simulated world. Evaluations take no time, and a simulated person answers at once."""

    def __init__(
        self,
        prepared: _Prepared,
        terminal: CalibrationTerminal,
        recorder: Recorder,
        phlosar: SimulatedPhlosar,
    ) -> None:
        super().__init__(prepared, terminal, recorder)
        self._phlosar = phlosar
        self._world = self._simulated = _RecordedWorld(prepared, phlosar, recorder)
        self._angles = SimulatedAngleReader(seed=1)
        self._steps = 0

    async def _pass_time(self) -> None:
        # The event loop learns of Ctrl-C.
        await asyncio.sleep(0)
        self._steps += 1
        self._actions.extend(self._simulated.advance(self._steps * STEP_S))
        if self._steps % STEPS_PER_SNAPSHOT == 0:
            self._recorder.snapshot(self._snapshot())

    def _ask(self, intent: Intent) -> None:
        self._actions.extend(self._simulated.feed(Asked(self._now, "calibration", intent)))

    def _question(self, question: Question) -> None:
        text = ""
        if question.kind == "angle":
            text = f"{self._angles.read(self._phlosar.cv_kPa):.1f}"
        elif question.number > 1:
            # The first question asks to empty the reservoir, which is empty. The second asks to fill it.
            self._phlosar.fill(self._prepared.plan.user_config.pneumatics.full_kPa)
        self._answer(question, text)

    def _evaluate(self, task: EvaluationTask) -> None:
        self._evaluated(task, result_of(task))

    async def _close(self) -> None:
        self._actions.extend(self._simulated.feed(Stop(self._now)))


class _RecordedWorld(SimulatedWorld):
    """A simulated world that records the same events and actions as the service does."""

    def __init__(self, prepared: _Prepared, phlosar: SimulatedPhlosar, recorder: Recorder) -> None:
        config = prepared.plan.config
        super().__init__(config, phlosar, prior=prepared.prior, stored=prepared.stored)
        self._recorder = recorder
        self._mavlink = MavlinkCodec(config.vehicle.system_id, config.vehicle.component_id)

    def feed(self, event: Event) -> Iterator[Action]:
        actions = list(super().feed(event))
        self._recorder.event(event)
        for action in actions:
            if isinstance(action, ToVehicle):
                self._mavlink.encode(action.message, action.system_id)
            self._recorder.action(action)
        return iter(actions)


class SimulatedAngleReader:
    """A person who reads the angle of the simulated vine, with hysteresis and reading errors."""

    def __init__(self, seed: int = 1) -> None:
        self._curve = BendCurve(CURVE, HYSTERESIS_KPA)
        self._random = Random(seed)
        self._bent_kPa = 0.0

    def read(self, cv_kPa: float) -> float:
        """The angle in degrees at a true gauge pressure. Call it in the order of the movement."""
        self._bent_kPa = self._curve.bent_kPa(cv_kPa, self._bent_kPa)
        angle_deg = self._curve.angle_deg(self._bent_kPa) + self._random.gauss(0.0, READING_SD_DEG)
        return round(max(0.0, angle_deg), 1)

"""A scripted and checked flight: the real service between a simulated autopilot and phloSAR.

Each step acts on the world and has expectations with a time limit. The flight passes if all expectations are
met and each kind of trigger occurs exactly as often as the script causes it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.core.events import Action, Decision
from flying_vines.core.snapshot import Snapshot
from flying_vines.core.watcher import EachAction
from flying_vines.files.extras import lacks
from flying_vines.gateway.gateway import Gateway
from flying_vines.gateway.page_token import address
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.record.reader import FlightLog
from flying_vines.record.recorder import FlightStart, Recorder
from flying_vines.service.service import Service
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot_server import FIRST_CLIENT, AutopilotServer, GroundStation
from flying_vines.simulation.phlosar.mishaps import Hole
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar
from flying_vines.terminal import vine_sketch as sketch
from flying_vines.terminal.screen import LiveView, event_line
from flying_vines.vehicle.component.telemetry import VALUE_NAMES
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.notice import Notice, Severity
from missions.home import SIMULATOR_HOME

POLL_S = 0.05
SWITCH_CHANNEL = 9
LOW, MIDDLE, HIGH = 1000, 1500, 2000
CRUISE_M = 6.0
LEAK = Hole(bore_mm=4.0)
EMPTY_KPA = 30.0
MIN_WIDTH_FOR_VINE = 110
"""From this terminal width on, the vine is drawn next to the live view."""


@dataclass
class World:
    """Everything that a step can act on and check."""

    config: Config
    autopilot: FakeAutopilot
    phlosar: SimulatedPhlosar
    ground: GroundStation
    decisions: list[Decision] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    snapshot: Snapshot | None = None
    late_s: float = 0.0
    """How late this computer was at worst."""

    def decided(self, since: float, trigger: str, safety: str, reason: str = "", **what: object) -> bool:
        """True if a decision since this time has this trigger, verdict and reason, and these details."""
        return any(
            d.t >= since
            and (d.trigger, d.safety) == (trigger, safety)
            and reason in d.reason
            and all(d.what.get(key) == value for key, value in what.items())
            for d in self.decisions
        )

    def noticed(self, since: float, text: str) -> bool:
        return any(n.t >= since and text in n.text for n in self.notices)

    @property
    def bend_deg(self) -> float:
        return self.snapshot.bend_deg if self.snapshot else 0.0

    @property
    def vented(self) -> bool:
        """True if the vine is vented in the plant itself, and not only in telemetry."""
        return self.phlosar.cv_kPa < 1.0 and self.phlosar.drive.evp == 0.0


@dataclass(frozen=True)
class Expectation:
    """A condition that must become true within a time after a step."""

    what: str
    within_s: float
    met: Callable[[World, float], bool]
    """Arguments: the world, and the start time of the step."""
    lasts: bool = False
    """True if the condition must hold during the whole `within_s`."""


@dataclass(frozen=True)
class DemoStep:
    at_s: float
    title: str
    act: Callable[[World], None]
    expect: tuple[Expectation, ...]


@dataclass
class DemoOutcome:
    """The result of an expectation. `met_after_s` is None until it is met."""

    step: DemoStep
    expectation: Expectation
    began: float
    met_after_s: float | None = None
    failed: bool = False

    def update(self, world: World, now: float) -> None:
        """Check the condition; set `met_after_s` or `failed`."""
        if self.failed or self.met_after_s is not None:
            return
        late = now - self.began > self.expectation.within_s
        met = self.expectation.met(world, self.began)
        if met and (late if self.expectation.lasts else not late):
            self.met_after_s = now - self.began
        elif late or (self.expectation.lasts and not met):
            self.failed = True


def demo_mission() -> list[MissionItem]:
    """Home, take-off, a waypoint, the vine item, and a waypoint too far to reach during the flight."""
    return [
        _position(0, 16, 0.0, 584.0, frame=0),
        _position(1, 22, 0.0, CRUISE_M),
        _position(2, 16, 5.0, CRUISE_M),
        MissionItem(3, 217, (1.0, 40.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        _position(4, 16, 200.0, CRUISE_M),
    ]


def _position(seq: int, command: int, north_m: float, altitude_m: float, frame: int = 3) -> MissionItem:
    latitude, longitude = SIMULATOR_HOME["ardupilot"].global_deg(north_m, 0.0)
    return MissionItem(seq, command, (0.0, 0.0, 0.0, 0.0, latitude, longitude, altitude_m), frame=frame)


def _switch(pulse_us: int) -> Callable[[World], None]:
    return lambda w: w.autopilot.set_rc(SWITCH_CHANNEL, pulse_us)


def _switched(position: int, safety: str = "accepted", reason: str = "") -> Expectation:
    text = f"switch seen in position {position}, bend {safety}"
    return Expectation(
        text, 1.0, lambda w, since: w.decided(since, "switch", safety, reason, position=position)
    )


def _shown(what: str, within_s: float, holds: Callable[[Snapshot], bool]) -> Expectation:
    return Expectation(what, within_s, lambda w, since: w.snapshot is not None and holds(w.snapshot))


def _bends_to(angle_deg: float) -> Expectation:
    return Expectation(f"vine at {angle_deg:g}°", 2.0, lambda w, since: abs(w.bend_deg - angle_deg) < 4.0)


def _vented(within_s: float) -> Expectation:
    return Expectation("vine vented", within_s, lambda w, since: w.vented)


def _stays_vented(for_s: float) -> Expectation:
    return Expectation("vine stays vented", for_s, lambda w, since: w.vented, lasts=True)


def _lost(loss: str, within_s: float) -> Expectation:
    return Expectation(
        f"safe state entered: {loss}",
        within_s,
        lambda w, since: w.decided(since, "failsafe", "accepted", loss=loss),
    )


def _pilot_reads(text: str, within_s: float) -> Expectation:
    return Expectation(f"pilot reads: “{text}”", within_s, lambda w, since: w.noticed(since, text))


SCRIPT = (
    DemoStep(
        0.5,
        "Power on",
        lambda w: None,
        (
            _shown("phloSAR answers", 3.0, lambda seen: seen.firmware == "ready"),
            _shown("RC received", 4.0, lambda seen: seen.rc == "good"),
            Expectation(
                "ground station sees all values", 5.0, lambda w, _: w.ground.values.keys() >= set(VALUE_NAMES)
            ),
        ),
    ),
    DemoStep(
        2.5,
        "Arm and take off",
        lambda w: w.autopilot.takeoff(CRUISE_M),
        (
            _shown("armed", 2.0, lambda seen: seen.armed),
            _shown("above 4 m", 5.0, lambda seen: seen.altitude_m > 4.0),
        ),
    ),
    DemoStep(7.0, "Switch to the middle", _switch(MIDDLE), (_switched(1), _bends_to(30.0))),
    DemoStep(8.3, "Switch up", _switch(HIGH), (_switched(2), _bends_to(60.0))),
    DemoStep(9.5, "Switch down", _switch(LOW), (_switched(0), _vented(2.0))),
    DemoStep(
        10.5,
        "Fly the mission: item 3 bends to 40°",
        lambda w: w.autopilot.start_mission(),
        (
            Expectation(
                "mission item 3 seen, bend accepted",
                5.0,
                lambda w, since: w.decided(since, "mission_item", "accepted", seq=3),
            ),
            Expectation("vine at 40°", 6.0, lambda w, since: abs(w.bend_deg - 40.0) < 4.0),
        ),
    ),
    DemoStep(14.5, "RC is lost", lambda w: w.autopilot.lose_rc("frozen"), (_lost("rc", 2.0), _vented(3.0))),
    DemoStep(16.0, "The pilot moves the switch, but RC is lost", _switch(HIGH), ()),
    DemoStep(
        16.5,
        "RC returns",
        lambda w: w.autopilot.return_rc(),
        (
            _pilot_reads("RC is back", 1.0),
            _pilot_reads("to bend: switch down, then up", 2.5),
            _stays_vented(2.4),
        ),
    ),
    DemoStep(19.0, "The pilot moves the switch down", _switch(LOW), (_switched(0),)),
    DemoStep(20.0, "... and to the middle", _switch(MIDDLE), (_switched(1), _bends_to(30.0))),
    DemoStep(
        21.5,
        "The reservoir gets a hole",
        lambda w: w.phlosar.inject("reservoir", LEAK),
        (_lost("reservoir_loss", 2.0), _vented(2.5), _pilot_reads("reservoir loses", 2.0)),
    ),
    DemoStep(24.0, "Switch down", _switch(LOW), (_switched(0),)),
    DemoStep(
        25.0,
        "Switch up with an empty reservoir",
        _switch(HIGH),
        (_switched(2, "refused", "reservoir"), _pilot_reads("refused bend-full", 1.0), _stays_vented(3.0)),
    ),
    DemoStep(
        25.8,
        "Land",
        lambda w: w.autopilot.land(),
        (
            _shown("landed and disarmed", 12.0, lambda seen: not seen.armed),
            _stays_vented(6.0),
            Expectation(
                "ground station got the refusal",
                8.0,
                lambda w, _: any("refused bend-full" in text for text in w.ground.texts),
            ),
        ),
    ),
)

EXPECTED_TRIGGERS = {"switch": 7, "mission_item": 1, "command": 0}
"""Number of triggers by kind. The switch move during RC loss is not a trigger."""


@dataclass(frozen=True)
class DemoFlight:
    """The result of a scripted flight."""

    outcomes: list[DemoOutcome]
    unexpected_triggers: list[str]
    """A text for each kind of trigger with an unexpected number."""
    folder: Path
    picture: Path | None
    values: dict[str, float]
    late_s: float
    """How late this computer was at worst."""

    @property
    def passed(self) -> bool:
        return not self.unexpected_triggers and all(o.met_after_s is not None for o in self.outcomes)


async def fly(
    out: Path, console: Console, live: bool, rig: TrueRig | None = None, page: bool = False
) -> DemoFlight:
    """Fly the script in real time; log and picture go to `out`. `page`: serve the status page."""
    ground = GroundStation()
    ground_port = await ground.listen()
    phlosar = SimulatedPhlosar(rig, reservoir_kPa=690.0)
    autopilot = FakeAutopilot("ardupilot", mission=demo_mission(), rc_failsafe_mode=None)
    autopilot.set_rc(SWITCH_CHANNEL, LOW)
    server = AutopilotServer(autopilot, FIRST_CLIENT, ("127.0.0.1", ground_port), listen=[("127.0.0.1", 0)])
    await server.open()
    with PtyPhlosar(phlosar) as port:
        default = configuration.default()
        text = configuration.default_text()
        text = text.replace(default.vehicle.link, f"tcp:127.0.0.1:{server.ports[0]}")
        text = text.replace(default.firmware.link, f"serial:{port.path}")
        config = configuration.parse(text, "the demo's configuration")
        log = Recorder(out, FlightStart(text, config.pneumatics))
        world = World(config, autopilot, phlosar, ground)
        began = asyncio.get_running_loop().time()
        view = LiveView(began, config.limits.max_kPa, config.pneumatics.full_kPa)

        def take(action: Action) -> None:
            view.take(action)
            if isinstance(action, Decision):
                world.decisions.append(action)
            elif isinstance(action, Notice):
                world.notices.append(action)
            line = None if live else event_line(action, began)
            if line is not None:
                console.print(line, soft_wrap=True)

        gateway = Gateway(
            config,
            ask=lambda *request: service.ask(*request),
            say=lambda text: service.say(Severity.WARNING, text),
        )
        service = Service(config, (log, EachAction(take), gateway))
        parts = (server, port, ground, *((gateway,) if page else ()))
        if page:
            view.say(Text(f"Page {address(config.page)}", style="bold"))
            console.print(f"Page {address(config.page)}")
        async with asyncio.TaskGroup() as tasks:
            running = [tasks.create_task(part.run()) for part in parts]
            serving = tasks.create_task(service.run())
            outcomes = await _direct(world, service, view, console, live)
            service.stop()
            await serving
            for task in running:
                task.cancel()
    log.close()
    picture = _draw(log, console)
    return DemoFlight(
        outcomes, _unexpected_triggers(world), log.folder, picture, dict(ground.values), world.late_s
    )


async def _direct(
    world: World, service: Service, view: LiveView, console: Console, live: bool
) -> list[DemoOutcome]:
    """Run the steps at their times, and check their expectations."""
    began = service.now
    waiting = list(SCRIPT)
    outcomes: list[DemoOutcome] = []
    screen = Live(console=console, refresh_per_second=10, screen=True) if live else None
    if screen:
        screen.start()
    due = service.now
    try:
        while True:
            now = service.now
            world.late_s, due = max(world.late_s, now - due), now + POLL_S
            while waiting and now - began >= waiting[0].at_s:
                step = waiting.pop(0)
                outcomes.extend(DemoOutcome(step, expectation, now) for expectation in step.expect)
                title = Text(f"{now - began:7.2f}  ▶ {step.title}", style="bold magenta")
                view.say(title)
                if not live:
                    console.print(title)
                step.act(world)
            world.snapshot = service.core.snapshot(now)
            if world.phlosar.reservoir_kPa < EMPTY_KPA:
                world.phlosar.mishaps.reservoir = None
            for outcome in outcomes:
                outcome.update(world, now)
            if screen:
                panel = view.render(world.snapshot, "Flying Vines demo")
                screen.update(_with_vine(panel, world.bend_deg, console))
            if not waiting and all(o.failed or o.met_after_s is not None for o in outcomes):
                return outcomes
            await asyncio.sleep(POLL_S)
    finally:
        if screen:
            screen.stop()


def _with_vine(view: RenderableType, bend_deg: float, console: Console) -> RenderableType:
    """The live view, with the bent vine if the terminal is wide enough."""
    if console.width < MIN_WIDTH_FOR_VINE:
        return view
    both = Table.grid(padding=(0, 1), expand=True)
    both.add_column(ratio=1)
    both.add_column(width=sketch.COLUMNS)
    lines = sketch.sketch(bend_deg, unicode=console.encoding.startswith("utf"))
    both.add_row(view, Text("\n" + "\n".join(lines), style="green", no_wrap=True))
    return both


def _unexpected_triggers(world: World) -> list[str]:
    """A text for each kind of trigger with an unexpected number."""
    found = []
    for kind, expected in EXPECTED_TRIGGERS.items():
        times = sum(d.trigger == kind for d in world.decisions)
        if times != expected:
            found.append(f"{times} triggers of kind {kind} instead of {expected}")
    return found


def _draw(log: Recorder, console: Console) -> Path | None:
    try:
        from flying_vines.record.picture import draw_flight
    except ModuleNotFoundError as error:
        console.print(f"No picture: {lacks(error)}.")
        return None
    path = log.folder / "flight.png"
    draw_flight(FlightLog(log.folder), path, "Flying Vines demo flight")
    return path


def summary(flight: DemoFlight) -> Table:
    """A table of the script's steps with their expectations and results."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("at, s", justify="right")
    table.add_column("step")
    table.add_column("must happen")
    table.add_column("after, s", justify="right")
    table.add_column("")
    shown: DemoStep | None = None
    for outcome in flight.outcomes:
        first = outcome.step is not shown
        shown = outcome.step
        met = outcome.met_after_s
        table.add_row(
            f"{outcome.step.at_s:g}" if first else "",
            outcome.step.title if first else "",
            outcome.expectation.what,
            f"{met:.2f}" if met is not None else "–",
            Text("ok", style="green") if met is not None else Text("FAILED", style="bold red"),
        )
    return table

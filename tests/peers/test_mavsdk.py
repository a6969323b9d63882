"""mavsdk as a ground station beside the real service and a simulated autopilot."""

from __future__ import annotations

import asyncio
import gc
import io
import itertools
import os
import weakref
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from ports import free_port
from real_time import real_time
from rich.console import Console
from service_bench import between
from waiting import MAX_WAIT_S, until

from flying_vines.config import config
from flying_vines.core.events import Action, Decision
from flying_vines.core.watcher import EachAction
from flying_vines.service.service import Service
from flying_vines.simulation.autopilot import AutopilotKind, FakeAutopilot
from flying_vines.simulation.autopilot_server import AutopilotServer
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar
from missions.files import load_items
from missions.link import MessageQueue, ReceivedMessage, VehicleLinkError, vehicle
from missions.transfer import download, upload
from missions.watch import watch

pytestmark = [real_time, pytest.mark.long]

if not os.environ.get("CI"):
    pytest.importorskip(
        "mavsdk", reason="needs mavsdk: pip install 'flying-vines[missions]', on 64-bit systems"
    )

RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"
KINDS = pytest.mark.parametrize("kind", ["ardupilot", "px4"])
SPEED = 4.0
COMPANION = 191
BEND_TO = 31011

VINE_ITEMS = {"ardupilot": [3, 5, 7, 9], "px4": [2, 4, 6, 8]}


def recorded(kind: AutopilotKind) -> Path:
    """The recorded vine mission of a real autopilot of this kind."""
    return RECORDINGS / f"{kind}_vine_mission.waypoints"


@dataclass
class Scene:
    """A service with its peers, and a link for one more."""

    autopilot: FakeAutopilot
    service: Service
    link: str
    actions: list[Action] = field(default_factory=list)

    def decided(self, trigger: str) -> list[Decision]:
        return [a for a in self.actions if isinstance(a, Decision) and a.trigger == trigger]

    def items_fired(self) -> list[object]:
        return [a.what["seq"] for a in self.decided("mission_item")]


@asynccontextmanager
async def scene(kind: AutopilotKind, speed: float = 1.0) -> AsyncIterator[Scene]:
    autopilot = FakeAutopilot(kind)
    autopilot.set_rc(9, 1000)
    companion_port = free_port()
    server = AutopilotServer(autopilot, ("127.0.0.1", companion_port), listen=[("127.0.0.1", 0)], speed=speed)
    with PtyPhlosar(SimulatedPhlosar()) as port:
        actions: list[Action] = []
        service = Service(
            config.parse(between(companion_port, port.path), "test"), (EachAction(actions.append),)
        )
        running = [asyncio.create_task(part.run()) for part in (server, port)]
        serving = asyncio.create_task(service.run())
        await server.ready.wait()
        await until(lambda: service.core.snapshot(service.now).switch_position == 0, "the service is up")
        try:
            yield Scene(autopilot, service, f"tcp:127.0.0.1:{server.ports[0]}", actions)
        finally:
            service.stop()
            await serving
            for task in running:
                task.cancel()
            await asyncio.gather(*running, return_exceptions=True)


def paper() -> Console:
    return Console(file=io.StringIO(), highlight=False, width=200)


def written(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


async def first_of(queue: MessageQueue, what: Callable[[ReceivedMessage], bool]) -> ReceivedMessage:
    """The first matching message."""
    async with asyncio.timeout(MAX_WAIT_S):
        while True:
            for message in await queue.receive(1.0):
                if what(message):
                    return message


@KINDS
async def test_an_uploaded_mission_is_flown_and_each_vine_item_fires_once(
    kind: AutopilotKind, tmp_path: Path
) -> None:
    async with scene(kind, SPEED) as flight:
        console = paper()
        assert await upload(recorded(kind), flight.link, console) == 0, written(console)
        flight.autopilot.start_mission()
        watching = paper()
        assert await watch(flight.link, watching, live=False) == 0
        assert flight.items_fired() == VINE_ITEMS[kind]
        assert [item.seq for _, item in flight.autopilot.payload_log] == VINE_ITEMS[kind]
        decided = flight.decided("mission_item")
        assert {a.safety for a in decided} == {"accepted"}, decided
        for suffix in (".waypoints", ".plan"):
            path = tmp_path / f"got{suffix}"
            assert await download(path, flight.link, paper()) == 0
            assert [i.command for i in load_items(path, kind).items] == [
                i.command for i in load_items(recorded(kind), kind).items
            ]
    story = written(watching)
    for seq in VINE_ITEMS[kind]:
        assert story.count(f"item {seq}: ") == 1, story
    assert "CYC_LEFT" in story and "RES_KPA" in story
    assert "The mission ended" in story


@KINDS
async def test_values_texts_and_acknowledgements_of_the_vine_come_through_the_autopilot(
    kind: AutopilotKind,
) -> None:
    async with scene(kind, 2.0) as flight, vehicle(flight.link) as peer:
        assert peer.kind == kind
        queue = peer.listen("NAMED_VALUE_FLOAT", "STATUSTEXT")
        names: set[str] = set()
        while not names >= {"RES_KPA", "CYC_LEFT", "CV_KPA", "CMD_KPA", "BEND_DEG"}:
            value = await first_of(
                queue, lambda m: m.component == COMPANION and m.name == "NAMED_VALUE_FLOAT"
            )
            names.add(value.fields["name"])
        # On the ground and disarmed the vine must not bend: the command is refused with a reason.
        assert await peer.command(BEND_TO, 30.0, component=COMPANION) == 2
        refusal = await first_of(queue, lambda m: m.component == COMPANION and m.name == "STATUSTEXT")
        assert refusal.fields["text"].startswith("Vine: ")
        flight.autopilot.takeoff(8.0)
        await until(lambda: flight.autopilot.flight.height_m > 7.0, "in the air")
        await until(lambda: flight.service.core.snapshot(flight.service.now).altitude_m > 7.0, "it knows")
        assert await peer.command(BEND_TO, 30.0, component=COMPANION) == 0
        await until(lambda: flight.decided("command")[-1].safety == "accepted", "its decision is told")
        # mavsdk repeats a command that is answered late, but does not count: each repeat is a new command.
        decided = [key for key, _ in itertools.groupby(a.safety for a in flight.decided("command"))]
        assert decided == ["refused", "accepted"]
        await first_of(
            queue,
            lambda m: (
                m.component == COMPANION
                and m.fields.get("name") == "BEND_DEG"
                and abs(m.fields["value"] - 30.0) < 4.0
            ),
        )


@KINDS
async def test_a_refused_mission_is_reported_by_item_and_what_is_left(
    kind: AutopilotKind, tmp_path: Path
) -> None:
    unknown = {"ardupilot": ("\t217\t2\t-25", "\t31010\t2\t-25"), "px4": ("\t42600\t", "\t31010\t")}[kind]
    path = tmp_path / "refused.waypoints"
    path.write_text(recorded(kind).read_text().replace(*unknown))
    async with bare(FakeAutopilot(kind)) as link:
        assert await upload(recorded(kind), link, paper()) == 0
        console = paper()
        assert await upload(path, link, console) == 2
    first, *rest = written(console).splitlines()[1:]
    seq = {"ardupilot": 7, "px4": 6}[kind]
    assert first.startswith(f"Refused: item {seq} (user 1 (")
    assert first.endswith("command 31010): the vehicle does not know this command in a mission.")
    if kind == "px4":
        assert rest == ["The vehicle still has its old mission of 11 items."]
    else:
        assert "mix of old and new" in rest[0]
        assert [line.split()[1] for line in rest[1:]] == ["new"] * 7 + ["old"] * 5


async def test_changes_by_the_storage_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "rounded.waypoints"
    path.write_text(recorded("ardupilot").read_text().replace("\t217\t1\t40", "\t217\t1.9\t40"))
    assert path.read_text() != recorded("ardupilot").read_text()
    async with bare(FakeAutopilot("ardupilot")) as link:
        console = paper()
        assert await upload(path, link, console) == 0
    assert "item 3 (script message (1.9, 40)): param1 1.9 is stored as 1." in written(console)


async def test_no_vehicle_is_reported_in_one_line() -> None:
    with pytest.raises(VehicleLinkError, match=r"^udpin:127\.0\.0\.1:\d+: no vehicle found within 0\.5 s$"):
        async with vehicle(f"udpin:127.0.0.1:{free_port()}", within_s=0.5):
            pass


async def test_objects_that_mavsdk_may_still_call_outlive_it() -> None:
    """Otherwise the process sometimes crashes: in 8 of 300 interrupted runs on a busy computer."""
    async with bare(FakeAutopilot("px4")) as link, vehicle(link) as peer:
        assert await peer.command(511, 42.0, 200_000.0) == 0
        answer = weakref.ref(peer._direct._callbacks[-1])
    del peer
    gc.collect()
    assert answer() is not None


async def test_several_clients_have_a_port_of_the_autopilot_each() -> None:
    async with bare(FakeAutopilot("px4")) as link, vehicle(link) as one, vehicle(link) as other:
        queue = other.listen("STATUSTEXT")
        assert await one.command(511, 33, 100_000.0) == 0
        assert await other.command(31010) == 3
        assert not [message for message in queue.waiting() if message.component == COMPANION]


@asynccontextmanager
async def bare(autopilot: FakeAutopilot) -> AsyncIterator[str]:
    """An autopilot alone. Yields the link to it."""
    server = AutopilotServer(autopilot, None, listen=[("127.0.0.1", 0)])
    running = asyncio.create_task(server.run())
    await server.ready.wait()
    try:
        yield f"tcp:127.0.0.1:{server.ports[0]}"
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

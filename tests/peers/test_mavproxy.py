"""MAVProxy with typed commands, behind the simulated autopilot to which the service is connected.

One MAVProxy for each kind of autopilot, because it takes seconds to start. Every test first selects the
addressed component.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import pytest_asyncio
from ports import free_port
from real_time import real_time
from service_bench import between
from waiting import MAX_WAIT_S, until

from flying_vines.config import config
from flying_vines.service.service import Service
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot_server import AutopilotServer
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar
from flying_vines.vehicle.component.parameter_table import SETTINGS
from flying_vines.vehicle.mavlink.signing import Signing, read_key
from flying_vines.vehicle.mission.item import AutopilotKind
from peers.mavproxy import HOW_TO_INSTALL, MavProxy, installed, mavproxy

pytestmark = [
    real_time,
    pytest.mark.long,
    pytest.mark.skipif(not installed() and not os.environ.get("CI"), reason=HOW_TO_INSTALL),
    pytest.mark.asyncio(loop_scope="module"),
]

EXAMPLES = Path(__file__).parents[2] / "missions" / "examples"
NUMBER = r"(-?[\d.]+(?:e-?\d+)?)"


@dataclass
class Flight:
    """The running programs, and the ground station that sees them through the autopilot."""

    kind: AutopilotKind
    autopilot: FakeAutopilot
    phlosar: SimulatedPhlosar
    ground: MavProxy

    async def value(self, name: str, wanted: Callable[[float], bool]) -> float:
        """Wait until MAVProxy shows such a number of a named value."""
        async with asyncio.timeout(MAX_WAIT_S):
            while True:
                self.ground.type(f"status *{name}*")
                seen = await self.ground.sees(rf"name : {name}, value : {NUMBER}", again=f"status *{name}*")
                if wanted(float(seen[1])):
                    return float(seen[1])
                await asyncio.sleep(0.2)


@pytest_asyncio.fixture(params=["ardupilot", "px4"], scope="module", loop_scope="module")
async def flight(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[Flight]:
    kind: AutopilotKind = request.param
    async with flying(kind, tmp_path_factory.mktemp(kind)) as flight:
        await flight.ground.sees("Detected vehicle 1:191 on link 0")
        yield flight


@asynccontextmanager
async def flying(kind: AutopilotKind, folder: Path, key: bytes | None = None) -> AsyncIterator[Flight]:
    """An autopilot on a bench with the service and MAVProxy; with a `key` the first two sign."""
    autopilot = FakeAutopilot(kind, signing_key=key, unix_s=time.time())
    autopilot.set_rc(9, 1000)
    companion_port, ground_port = free_port(), free_port()
    phlosar = SimulatedPhlosar()
    server = AutopilotServer(autopilot, ("127.0.0.1", companion_port), ("127.0.0.1", ground_port))
    with PtyPhlosar(phlosar) as port:
        text = between(companion_port, port.path).replace("bench_mode = false", "bench_mode = true")
        service = Service(config.parse(text, "test"), signing=Signing(key) if key else None)
        running = [asyncio.create_task(part.run()) for part in (server, port, service)]
        async with mavproxy(ground_port, folder) as ground:
            yield Flight(kind, autopilot, phlosar, ground)
        for task in running:
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(*running)


async def test_the_gauge_is_seen_by_the_name_of_each_value(flight: Flight) -> None:
    names = ".*".join(("BEND_DEG", "CMD_KPA", "CV_KPA", "CYC_LEFT", "RES_KPA"))
    await flight.ground.sees(f"(?s){names}", again="status NAMED_VALUE_FLOAT*")
    shown_kPa = await flight.value("RES_KPA", lambda value: value > 0)
    assert shown_kPa == pytest.approx(flight.phlosar.reservoir_kPa, abs=5)


async def test_commands_move_the_vine_and_are_answered_as_text(flight: Flight) -> None:
    ground = flight.ground
    ground.type("vehicle 1:191")
    await ground.answers("long 31011 30", "Got COMMAND_ACK: USER_2: ACCEPTED")
    await flight.value("BEND_DEG", lambda value: value == pytest.approx(30, abs=3))
    await ground.answers("long 31012 500", "AP: Vine: 500 kPa limited to 20.7 kPa")
    await ground.sees("Got COMMAND_ACK: USER_3: ACCEPTED")
    await ground.answers("long 31011 95", "AP: Vine: refused bend .*95 deg is outside")
    await ground.sees("Got COMMAND_ACK: USER_2: DENIED")
    await ground.answers("long 31010 7", "Got COMMAND_ACK: USER_1: DENIED")
    await ground.answers("long USER_4 0", "Got COMMAND_ACK: USER_4: ACCEPTED")
    await until(lambda: flight.phlosar.cv_kPa < 1, "it is vented")


async def test_disarmed_pneumatics_do_not_bend_until_they_are_armed(flight: Flight) -> None:
    ground = flight.ground
    ground.type("vehicle 1:191")
    await ground.answers("long 31013 2", "Got COMMAND_ACK: USER_4: ACCEPTED")
    await ground.answers("long 31011 20", "Got COMMAND_ACK: USER_2: DENIED")
    await ground.sees("AP: Vine: refused bend 20 deg: the pneumatics are disarmed")
    await ground.answers("long 31013 3", "Got COMMAND_ACK: USER_4: ACCEPTED")
    await ground.answers("long 31011 20", "Got COMMAND_ACK: USER_2: ACCEPTED")
    await ground.answers("long 31013 0", "Got COMMAND_ACK: USER_4: ACCEPTED")


async def test_commands_for_the_autopilot_are_not_for_us(flight: Flight) -> None:
    """MAVProxy addresses the autopilot unless told otherwise."""
    flight.ground.type("vehicle 1:1")
    await flight.ground.answers("long 31011 30", "Got COMMAND_ACK: USER_2: UNSUPPORTED")
    flight.ground.type("vehicle 1:191")
    await flight.ground.answers("long 31014 9", "Got COMMAND_ACK: USER_5: DENIED")
    assert flight.phlosar.cv_kPa < 1


async def test_texts_are_printed_when_mavproxy_looks_at_all_components(flight: Flight) -> None:
    """By default it shows only the autopilot's texts, not ours."""
    ground = flight.ground
    ground.type("set target_component 0")
    flight.phlosar.reset_firmware()
    await ground.sees("AP: Vine: phloSAR restarted")
    await ground.answers("vehicle 1:191", "Got COMMAND_ACK: USER_5: ACCEPTED", again="long USER_5 1")
    ground.type("vehicle 1:1")
    since = len(ground.text)
    flight.phlosar.reset_firmware(watchdog=True)
    await ground.sees(
        "STATUSTEXT {.*text : Vine: (firmware fault: watchdog|phloSAR )", again="status STATUSTEXT"
    )
    assert "AP: Vine: firmware fault: watchdog" not in ground.text[since:]
    await ground.answers("vehicle 1:191", "Got COMMAND_ACK: USER_5: ACCEPTED", again="long USER_5 1")


async def test_a_plan_with_vine_items_is_loaded_and_listed(flight: Flight) -> None:
    plan = EXAMPLES / f"bridge_inspection-{flight.kind}.waypoints"
    text = plan.read_text()
    item_command = {"ardupilot": 217, "px4": 187}[flight.kind]
    items = [line.split() for line in text.splitlines()[1:]]
    bends = [item[4:6] for item in items if int(item[3]) == item_command]
    assert bends
    ground = flight.ground
    ground.type("vehicle 1:1")
    ground.type(f"wp load {plan}")
    await ground.sees(f"Sent all {len(items)} waypoints")
    await ground.sees("Got MISSION_ACK: TYPE_MISSION: ACCEPTED")
    await ground.answers("wp list", "Saved waypoints to way.txt")
    listed = re.findall(rf"\n{item_command} .* p1={NUMBER} p2={NUMBER}", ground.answer)
    assert [[float(p1), float(p2)] for p1, p2 in listed] == [[float(p1), float(p2)] for p1, p2 in bends]


async def test_parameters_are_fetched_set_and_kept_within_their_bounds(flight: Flight) -> None:
    ground = flight.ground
    ground.type("vehicle 1:191")
    ground.type("param fetch")
    await ground.sees(f"Received {len(SETTINGS)} parameters")
    ground.type("param show VINE*")
    names = ".*".join(sorted(setting.name for setting in SETTINGS))
    await ground.sees(f"(?s){names}")
    await ground.answers("param set VINE_MAX_BENT_S 45", "AP: Vine: VINE_MAX_BENT_S is 45, was 120")
    await ground.answers("param fetch VINE_MAX_BENT_S", r"VINE_MAX_BENT_S\s+= 45\.0")
    await ground.answers(
        "param set VINE_MAX_BENT_S 500", "AP: Vine: VINE_MAX_BENT_S stays 45: 500 is outside 1 to 120"
    )


async def test_signed_commands_are_carried_out_and_those_of_another_key_are_not(tmp_path: Path) -> None:
    """The passphrase in our key file and the one typed into MAVProxy give the same key."""
    file = tmp_path / "key"
    file.write_text("passphrase: vines-over-the-lake\n")
    file.chmod(0o600)
    async with flying("ardupilot", tmp_path, read_key(file)) as flight:
        ground = flight.ground
        await ground.sees("online system 1")
        await ground.answers("signing key some-other-words", "Setup signing key")
        ground.type("set target_component 191")
        ground.type("long 31011 30")
        await asyncio.sleep(1.5)
        assert ground.printed("COMMAND_ACK") is None
        assert flight.phlosar.cv_kPa < 1
        await ground.answers("signing key vines-over-the-lake", "Setup signing key")
        await ground.sees("Got COMMAND_ACK: USER_2: ACCEPTED", again="long 31011 30")
        await until(lambda: flight.phlosar.cv_kPa > 8, "it is bent")

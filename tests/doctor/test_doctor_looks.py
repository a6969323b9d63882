"""Facts that the doctor reads here: processes, ports, disk, clock, broker, a configuration's files."""

from __future__ import annotations

import asyncio
import ctypes
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from reservoir_bench import DEMONSTRATION, Bench
from serial.tools.list_ports_common import ListPortInfo
from waiting import MAX_WAIT_S

from firmware_link.find import UsbBoard
from flying_vines.config import config as configuration
from flying_vines.config.address import NetworkAddress, SerialAddress
from flying_vines.config.config import ConfigError, MqttConfig
from flying_vines.doctor import computer, network, ports, processes
from flying_vines.doctor.configuration import read
from flying_vines.doctor.network import BrokerFacts
from flying_vines.doctor.processes import Process
from flying_vines.service import host_clock
from flying_vines.supply import nominal
from flying_vines.supply.learned_file import text_of

HOLD_A_TERMINAL = (
    "import os, sys; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); print('open', flush=True); input()"
)
PLAY_A_TERMINAL = "import os; ours, theirs = os.openpty(); print(os.ttyname(theirs), flush=True); input()"
HOLD_A_PORT = (
    "import socket, sys; s = socket.socket(type=getattr(socket, sys.argv[1])); s.bind(('127.0.0.1', 0));"
    "sys.argv[1] == 'SOCK_STREAM' and s.listen(); print(s.getsockname()[1], flush=True); input()"
)


@contextmanager
def another(program: str, *arguments: str) -> Iterator[tuple[int, str]]:
    """Run another process that has something open. Yields its id, and the line that it prints."""
    with subprocess.Popen(
        [sys.executable, "-c", program, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield process.pid, process.stdout.readline().strip()
        process.stdin.close()


@pytest.fixture
def terminal() -> Iterator[str]:
    ours, theirs = os.openpty()
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def board(device: str, serial_number: str | None = "1234560") -> ListPortInfo:
    port = ListPortInfo(device)
    port.vid, port.pid, port.product, port.serial_number = 0x16C0, 0x0483, "USB Serial", serial_number
    return port


def proc(folder: Path, **cmdlines: list[str]) -> Path:
    for pid, arguments in cmdlines.items():
        process = folder / pid.removeprefix("p")
        process.mkdir()
        (process / "cmdline").write_bytes(b"\0".join(map(os.fsencode, arguments)) + b"\0")
        (process / "comm").write_text(Path(arguments[0]).name[:15] + "\n")
    return folder


def test_services_are_known_by_how_they_were_called(tmp_path: Path) -> None:
    there = proc(
        tmp_path,
        p10=["/usr/bin/python3", "/opt/venv/bin/flying-vines", "run", "--config", "vine.toml"],
        p11=["python", "-m", "flying_vines", "run", "--config", "vine.toml"],
        p12=["python", "-m", "flying_vines", "demo"],
        p13=["vim", "flying-vines"],
        p14=["/usr/sbin/ModemManager"],
        p15=["grep", "run"],
    )
    (tmp_path / "meminfo").write_text("")
    (tmp_path / "99").mkdir()
    (tmp_path / "10" / "cgroup").write_text("0::/system.slice/flying-vines.service\n")
    (tmp_path / "11" / "cgroup").write_text("0::/system.slice/ssh.service\n")
    found = processes.services(there)
    assert [(process.pid, process.unit) for process in found] == [(10, "flying-vines.service"), (11, "")]
    assert processes.runs("ModemManager", there)
    assert not processes.runs("minicom", there)


def test_a_machine_without_proc_gives_no_facts(tmp_path: Path) -> None:
    nowhere = tmp_path / "proc"
    assert processes.services(nowhere) == []
    assert processes.port_holders("udp", 14540, nowhere) == ()


def test_who_holds_a_terminal_is_found(terminal: str, tmp_path: Path) -> None:
    link = tmp_path / "phlosar"
    link.symlink_to(terminal)
    address = SerialAddress(str(link))
    assert ports.serial_port("phloSAR", f"serial:{link}", address, list).held_by == ()
    with another(HOLD_A_TERMINAL, terminal) as (pid, _):
        facts = ports.serial_port("phloSAR", f"serial:{link}", address, list)
    assert [process.pid for process in facts.held_by] == [pid]
    assert facts.path == f"{link} → {terminal}"
    assert facts.may_open


def test_a_program_in_place_of_the_device_does_not_hold_the_port() -> None:
    with another(PLAY_A_TERMINAL) as (_, terminal):
        assert processes.holders(terminal) == ()
        with another(HOLD_A_TERMINAL, terminal) as (pid, _):
            assert [process.pid for process in processes.holders(terminal)] == [pid]


def test_who_listens_is_found() -> None:
    with another(HOLD_A_PORT, "SOCK_DGRAM") as (pid, port):
        held_by = ports.udp_port(NetworkAddress("udpin", "0.0.0.0", int(port)))
    assert held_by is not None
    assert [process.pid for process in held_by] == [pid]
    with another(HOLD_A_PORT, "SOCK_STREAM") as (pid, port):
        why, holders = ports.tcp_port("127.0.0.1", int(port))
    assert why == "Address already in use"
    assert [process.pid for process in holders] == [pid]


def test_a_free_port_stays_free() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        free: int = probe.getsockname()[1]
    for _ in range(2):
        assert ports.udp_port(NetworkAddress("udpin", "127.0.0.1", free)) is None
        assert ports.tcp_port("127.0.0.1", free) == ("", ())


def test_a_board_is_named_by_what_it_is(terminal: str) -> None:
    facts = ports.serial_port("phloSAR", "usb:16c0:0483", UsbBoard(0x16C0, 0x0483), lambda: [board(terminal)])
    assert (facts.path, facts.missing) == (terminal, "")
    assert facts.board == "usb:16c0:0483, USB Serial, serial number 1234560"
    assert facts.usb == "usb:16c0:0483:1234560"


def test_a_port_that_is_not_there_is_reported_with_those_that_are(terminal: str) -> None:
    facts = ports.serial_port(
        "phloSAR", "serial:/dev/ttyACM7", SerialAddress("/dev/ttyACM7"), lambda: [board(terminal)]
    )
    assert facts.missing == (
        f"/dev/ttyACM7 does not exist; found: {terminal} (usb:16c0:0483, USB Serial, serial number 1234560)"
    )
    facts = ports.serial_port("phloSAR", "usb:16c0:0483", UsbBoard(0x16C0, 0x0483), list)
    assert "Present: no serial port" in facts.missing


def test_a_board_that_is_pulled_out_meanwhile_is_no_error() -> None:
    def stumble() -> list[ListPortInfo]:
        raise TypeError("pyserial read half of a file")

    assert ports.serial_port("phloSAR", "usb:16c0:0483", UsbBoard(0x16C0, 0x0483), stumble).missing


@pytest.mark.parametrize(
    ("said", "kept_off"), [("E:ID_MM_DEVICE_IGNORE=1\n", True), ("E:ID_MODEL=x\n", False), (None, False)]
)
def test_the_udev_rule_for_modem_manager_is_read(
    said: str | None, kept_off: bool, terminal: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    number = Path(terminal).stat().st_rdev
    if said is not None:
        (tmp_path / f"c{os.major(number)}:{os.minor(number)}").write_text(f"S:x\n{said}")
    monkeypatch.setattr(ports, "UDEV_DATA", tmp_path)
    facts = ports.serial_port("phloSAR", "serial:x", SerialAddress(terminal), list)
    assert facts.modem_manager_kept_off == kept_off


def test_the_kernel_s_console_is_known(
    terminal: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = tmp_path / "cmdline"
    monkeypatch.setattr(ports, "KERNEL_ARGUMENTS", arguments)
    name = terminal.removeprefix("/dev/").replace("/", "!")
    for said, console in ((f"console={name},115200 console=tty1 root=/dev/x", False), ("quiet", False)):
        arguments.write_text(said)
        facts = ports.serial_port("vehicle", "serial:x", SerialAddress(terminal), list)
        assert facts.console == console
    arguments.write_text("console=null,115200 quiet")
    assert ports.serial_port("vehicle", "serial:x", SerialAddress("/dev/null"), list).console


def test_a_raspberry_pi_s_throttling_word_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    word, zones = tmp_path / "get_throttled", tmp_path / "thermal"
    (zones / "thermal_zone0").mkdir(parents=True)
    (zones / "thermal_zone0" / "temp").write_text("61250\n")
    monkeypatch.setattr(computer, "THROTTLED", word)
    monkeypatch.setattr(computer, "TEMPERATURES", zones)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert computer.machine_facts().throttled is None
    assert computer.machine_facts().hottest_C == 61.25
    word.write_text("50005\n")
    assert computer.machine_facts().throttled == 0x50005
    word.unlink()
    program = tmp_path / "vcgencmd"
    program.write_text("#!/bin/sh\necho throttled=0x80000\n")
    program.chmod(0o755)
    assert computer.machine_facts().throttled == 0x80000
    assert (computer.machine_facts().free_MB or 0) > 1


def test_a_folder_is_tried_and_left_as_it_was(tmp_path: Path) -> None:
    facts = computer.disk_facts("flight logs", tmp_path / "not" / "yet", 1.0)
    assert facts.problem == ""
    assert facts.free_MB > 0
    assert 0 < facts.took_s < 60
    assert list(tmp_path.iterdir()) == []
    assert computer.disk_facts("state", Path("/proc/flights"), 0.0).problem
    file = tmp_path / "file"
    file.write_text("")
    assert computer.disk_facts("state", file, 0.0).problem == "Not a directory"


def test_the_clock_is_asked_and_its_jumps_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert host_clock.synchronised() in (True, False)
    looked = computer.Clock()
    assert abs(looked.facts(None, signing=False).jumped_s) < 0.1
    real = time.time
    monkeypatch.setattr(time, "time", lambda: real() + 7200.0)
    assert looked.facts(1.5, signing=True).jumped_s == pytest.approx(7200.0, abs=0.1)


def test_if_the_kernel_may_not_be_asked_timesyncd_answers(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    class Sandbox:
        def __init__(self, *_: object, **__: object) -> None:
            self.adjtimex = lambda _: -1

    monkeypatch.setattr(ctypes, "CDLL", Sandbox)
    monkeypatch.setattr(host_clock, "_BY_TIMESYNCD", tmp_path / "synchronized")
    assert host_clock.synchronised() is None
    (tmp_path / "synchronized").touch()
    assert host_clock.synchronised() is True


def of_broker(address: str, **others: str) -> BrokerFacts:
    return asyncio.run(network.broker_facts(MqttConfig(broker=address, **others)))  # type: ignore[arg-type]


def test_a_broker_that_is_not_there_is_reported_by_what_failed() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        closed = probe.getsockname()[1]
    assert of_broker("").broker == ""
    assert of_broker(f"mqtt://127.0.0.1:{closed}").problem == "nothing answers there"
    assert "unknown host name" in of_broker("mqtt://broker.invalid").problem


@pytest.mark.parametrize(
    ("answer", "says", "needs_person"),
    [
        (bytes([0x20, 3, 0, 0, 0]), "", False),
        (bytes([0x20, 3, 0, 0x86, 0]), "it does not accept this user and password", True),
        (bytes([0x20, 3, 0, 0x87, 0]), "it refuses the login", True),
    ],
)
def test_a_broker_is_asked_to_let_us_in(answer: bytes, says: str, needs_person: bool) -> None:
    received = bytearray()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        received.extend(await reader.read(1024))
        writer.write(answer)
        if not says:
            await reader.read()
        writer.close()
        await writer.wait_closed()
        gone.set()

    async def ask() -> BrokerFacts:
        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        async with server, asyncio.timeout(MAX_WAIT_S):
            port = server.sockets[0].getsockname()[1]
            found = await network.broker_facts(MqttConfig(broker=f"mqtt://127.0.0.1:{port}", username="vine"))
            await gone.wait()
            return found

    gone = asyncio.Event()
    found = asyncio.run(ask())
    assert (says in found.problem, bool(found.problem)) == (True, bool(says)), found
    assert found.needs_person == needs_person
    assert received[0] == 0x10, "CONNECT"
    assert b"vine" in received


def test_the_files_that_the_broker_needs_are_read(tmp_path: Path) -> None:
    none = str(tmp_path / "none")
    missing = of_broker("mqtt://127.0.0.1:9", username="vine", password_file=none)
    assert none in missing.problem
    assert missing.needs_person
    assert none in of_broker("mqtts://127.0.0.1:9", ca_file=none).problem


def test_a_missing_library_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "aiomqtt", None)
    found = of_broker("mqtt://127.0.0.1:9")
    assert found.missing_package


def write(folder: Path, text: str) -> Path:
    path = folder / "vine.toml"
    path.write_text(configuration.default_text().replace('rig = ""', text, 1))
    return path


def test_a_configuration_is_read_with_all_that_it_names(tmp_path: Path) -> None:
    healthy = read(write(tmp_path, 'rig = ""'))
    assert (healthy.rig, healthy.signing_key, healthy.disarming) == ("", "", "")
    assert healthy.state is not None and healthy.state.parameters.parent == tmp_path
    path = write(tmp_path, 'rig = "none.toml"')
    path.write_text(path.read_text().replace('signing_key = ""', 'signing_key = "key"'))
    (tmp_path / "key").write_text("passphrase: long enough")
    (tmp_path / "key").chmod(0o644)
    (tmp_path / "vine.disarmed").write_text("")
    (tmp_path / "vine.latched.json").write_text('{"deaf": "phloSAR gets no commands"}')
    (tmp_path / "vine.parameters.toml").write_text("FV_NONE = 3\n")
    facts = read(path)
    assert "none.toml" in facts.rig_problem
    assert "chmod 600" in facts.signing_problem
    assert facts.disarming == str(tmp_path / "vine.disarmed")
    assert facts.latched == {"deaf": "phloSAR gets no commands"}
    assert "FV_NONE" in facts.parameters_problem
    (tmp_path / "key").chmod(0o600)
    assert read(path).signing is not None
    path.write_text("[vehicle]\nlnk = 3\n")
    with pytest.raises(ConfigError, match="lnk"):
        read(path)


def test_the_air_that_earlier_flights_learned_is_read(tmp_path: Path) -> None:
    path = write(tmp_path, 'rig = ""')
    assert read(path).learned is None
    bench = Bench()
    bench.rest(6.0)
    bench.bend()
    learned = bench.estimate.learned
    assert learned is not None
    (tmp_path / "vine.air.json").write_text(text_of(nominal(DEMONSTRATION), learned))
    assert read(path).learned == learned
    (tmp_path / "vine.air.json").write_text("{")
    assert read(path).learned is None


def test_a_process_has_a_readable_name() -> None:
    assert str(Process(7, "minicom")) == "minicom (process 7)"
    assert str(Process(7, "run", "vine.service")) == "run (process 7, vine.service)"

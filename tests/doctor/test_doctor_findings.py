"""The doctor prints each line only for the facts that require it."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import msgspec
import pytest

from doctor.known_lines import every_line, matches
from firmware_link.protocol import PROTOCOL_VERSION, Fault, Setting, SettingsMemory, Units, Welcome
from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.doctor import computer, firmware, network, ports, processes, radio, vehicle
from flying_vines.doctor import configuration as configuration_check
from flying_vines.doctor.computer import ClockFacts, DiskFacts, MachineFacts, lateness_s
from flying_vines.doctor.finding import DoctorFinding, FindingText, may_fly, summary
from flying_vines.doctor.firmware import FirmwareFacts
from flying_vines.doctor.network import BrokerFacts
from flying_vines.doctor.ports import PortFacts
from flying_vines.doctor.processes import Process
from flying_vines.doctor.radio_test import RadioLearned, Sign, TransmitterLoss
from flying_vines.doctor.vehicle_probe import StreamFacts, SwitchFacts, VehicleFacts
from flying_vines.supply import CyclesLeft
from flying_vines.vehicle.mavlink.signing import RefusedFrames
from flying_vines.vehicle.mission.item import MissionItem

CONFIG = configuration.default()
FACTS = configuration_check.given(CONFIG, "vine.toml")
MACHINE = MachineFacts("0.1.0", "3.11.2", "Linux 6.12", "aarch64", 900.0, 0, 55.0)
DISK = DiskFacts("flight logs", "flights", free_MB=9000.0, least_free_MB=200.0, took_s=0.02)
STATE = DiskFacts("state", "/var/lib/flying-vines", free_MB=9000.0, took_s=0.02)
NOW = ClockFacts(1_795_000_000.0, synchronised=True)
OTHER = Process(812, "minicom")
SERVICE = Process(813, "flying-vines run", "flying-vines.service")
PORT = PortFacts("phloSAR", "usb:16c0:0483", path="/dev/ttyACM0", board="usb:16c0:0483", group="dialout")
WELCOME = Welcome(
    *(PROTOCOL_VERSION, 1, 0x1234, "1.0", Units.KPA_GAUGE, 30.0, 28.0, 760.0, 200.0, 300, 100),
    settings_digest=77,
    settings_memory=SettingsMemory.STORED,
)
SETTING = Setting(0, 1, "cv_limit_kPa", 30.0, 5.0, 60.0, 30.0)
FIRMWARE = FirmwareFacts(
    port="open",
    welcome=WELCOME,
    settings=(SETTING,),
    telemetry_Hz=99.8,
    good_frames=600,
    round_trip_s=0.002,
    cv_kPa=0.1,
    reservoir_kPa=650.0,
    cycles_left=CyclesLeft(60.0, 40.0, 90.0, 0.0, 9.0, 60.0, 20.7, 1.0, 80.0, 15.0, 600.0),
)
STREAMS = {
    name: StreamFacts(name, wanted_Hz, wanted_Hz, essential, refused=False)
    for name, wanted_Hz, essential in (
        ("RC_CHANNELS", 20.0, False),
        ("SYS_STATUS", 10.0, True),
        ("GLOBAL_POSITION_INT", 5.0, True),
        ("MISSION_CURRENT", 5.0, False),
        ("SYSTEM_TIME", 1.0, False),
        ("SCALED_PRESSURE", 1.0, False),
    )
}
VEHICLE = VehicleFacts(
    bytes=5000,
    messages=200,
    system_id=1,
    kind="ardupilot",
    version="4.6.0",
    mode="LOITER",
    longest_silence_s=1.0,
    heartbeat_Hz=1.0,
    streams=tuple(STREAMS.values()),
    ahead_s=0.1,
)
SWITCH = SwitchFacts(None, 1004, 0, frozenset({0}))
REFUSED = RefusedFrames(unsigned=7)

RC_STATUS = Sign("RC status", 1.1, "RC status (present, enabled, health) 1 1 1 → 0 1 0")
HELD = TransmitterLoss(True, 1000, 1000, (RC_STATUS,), ())
HELD_BENT = TransmitterLoss(True, 2000, 2000, (RC_STATUS,), ())
PRESET = TransmitterLoss(
    True, 1000, 2000, (Sign("channels", 0.2, "channel 9: 1000 → 2000 µs"), RC_STATUS), ()
)
UNSEEN = TransmitterLoss(True, 1000, 1000, (), ())
LEARNED = RadioLearned("px4", losses=(HELD, HELD_BENT), parameters={"COM_RC_LOSS_T": 0.5}, shows_within_s=1.6)


def changed(table: str, **values: object) -> Config:
    """The default configuration with other values in one table."""
    return msgspec.structs.replace(
        CONFIG, **{table: msgspec.structs.replace(getattr(CONFIG, table), **values)}
    )


def of_receiver(**learned: object) -> list[DoctorFinding]:
    return radio.check_radio_test(replace(LEARNED, **learned), CONFIG)  # type: ignore[arg-type]


def later(loss: TransmitterLoss, shown_s: float) -> TransmitterLoss:
    """The same loss, with its RC status at another time."""
    return replace(loss, signs=(*loss.signs[:-1], replace(RC_STATUS, after_s=shown_s)))


def of_configuration(**facts: object) -> list[DoctorFinding]:
    return configuration_check.check(replace(FACTS, **facts))  # type: ignore[arg-type]


def of_machine(**facts: object) -> list[DoctorFinding]:
    return computer.check_machine(replace(MACHINE, **facts))  # type: ignore[arg-type]


def of_disk(facts: DiskFacts, **others: object) -> list[DoctorFinding]:
    return [computer.check_disk(replace(facts, **others))]  # type: ignore[arg-type]


def of_clock(**facts: object) -> list[DoctorFinding]:
    looked = replace(NOW, **facts)  # type: ignore[arg-type]
    return [*computer.check_clock(looked), computer.check_clock_against_vehicle(looked)]


def of_port(**facts: object) -> list[DoctorFinding]:
    return ports.check(replace(PORT, **facts))  # type: ignore[arg-type]


def with_memory(memory: SettingsMemory) -> FirmwareFacts:
    return replace(FIRMWARE, welcome=replace(WELCOME, settings_memory=memory))


def of_firmware(config: Config = CONFIG, **facts: object) -> list[DoctorFinding]:
    return firmware.check(replace(FIRMWARE, **facts), config)  # type: ignore[arg-type]


def of_welcome(**limits: float) -> list[DoctorFinding]:
    return of_firmware(welcome=replace(WELCOME, **limits))  # type: ignore[arg-type]


def of_vehicle(config: Config = CONFIG, **facts: object) -> list[DoctorFinding]:
    return vehicle.check(replace(VEHICLE, **facts), config, 6.0)  # type: ignore[arg-type]


def of_stream(
    name: str, rate_Hz: float, *, refused: bool = False, kind: str = "ardupilot"
) -> list[DoctorFinding]:
    streams = {**STREAMS, name: replace(STREAMS[name], rate_Hz=rate_Hz, refused=refused)}
    return of_vehicle(streams=tuple(streams.values()), kind=kind)


def of_switch(asked: bool = False, config: Config = CONFIG, **facts: object) -> list[DoctorFinding]:
    return [radio.check_switch(replace(SWITCH, **facts), config, asked)]  # type: ignore[arg-type]


def of_mission(*commands: tuple[int, float, float]) -> list[DoctorFinding]:
    items = {
        seq: MissionItem(seq, command, (param1, param2, 0.0, 0.0, 0.0, 0.0, 0.0))
        for seq, (command, param1, param2) in enumerate(commands)
    }
    return vehicle.check_mission(items, True, CONFIG)


def of_broker(**facts: object) -> list[DoctorFinding]:
    return [network.check_broker(replace(BrokerFacts("broker:1883"), **facts))]  # type: ignore[arg-type]


def of_page(address: str = "127.0.0.1:8017", **facts: Any) -> list[DoctorFinding]:
    return [network.check_page(address, **facts)]


SIGNED = changed("vehicle", signing_key="key")
HOME, WAYPOINT, SCRIPT = (16, 0.0, 0.0), (16, 0.0, 0.0), 217

CASES: list[tuple[FindingText, list[DoctorFinding]]] = [
    (configuration_check.GOOD, of_configuration()),
    (configuration_check.RIG_READ, of_configuration(rig="rig.toml", rig_summary="reservoir 2 L")),
    (configuration_check.BAD_RIG, of_configuration(rig="rig.toml", rig_problem="rig.toml:3: no such cause")),
    (configuration_check.KEY, of_configuration(signing_key="vine.key")),
    (
        configuration_check.BAD_KEY,
        of_configuration(signing_key="vine.key", signing_problem="vine.key: others may read it"),
    ),
    (configuration_check.VEHICLE_LINK, of_configuration()),
    (
        configuration_check.VEHICLE_LINK,
        of_configuration(config=changed("vehicle", link="udpin:0.0.0.0:1", signing_key="key")),
    ),
    (
        configuration_check.OPEN_TO_NETWORK,
        of_configuration(config=changed("vehicle", link="tcp:10.0.0.7:5760")),
    ),
    (configuration_check.NO_CLOCK, of_configuration(signing_clock_problem="stamp: damaged")),
    (configuration_check.SET_BY_PILOT, of_configuration(parameters={"FV_MAX_KPA": 15.0})),
    (configuration_check.IGNORED, of_configuration(ignored=["p.toml:1: VINE_AP_ACTION: is ignored"])),
    (configuration_check.BAD_PARAMETERS, of_configuration(parameters_problem="p.toml:1: damaged")),
    (configuration_check.DISARMED, of_configuration(disarming="vine.disarmed")),
    (configuration_check.LATCHED, of_configuration(latched={"overpressure": "vine at 60.0 kPa, limit 50"})),
    (configuration_check.BENCH, of_configuration(config=changed("interlocks", bench_mode=True))),
    (computer.LINUX, of_machine()),
    (computer.NOT_LINUX, of_machine(system="Darwin 24")),
    (computer.MEMORY, of_machine(free_MB=200.0)),
    (computer.LITTLE_MEMORY, of_machine(free_MB=199.0)),
    (computer.SUPPLY, of_machine()),
    (computer.SUPPLY_NOW, of_machine(throttled=0x50005)),
    (computer.SUPPLY_BEFORE, of_machine(throttled=0x50000)),
    (computer.NO_SUPPLY, of_machine(throttled=None)),
    (computer.COOL, of_machine(hottest_C=79.0)),
    (computer.HOT, of_machine(hottest_C=80.0)),
    (computer.DISK, of_disk(DISK)),
    (computer.NO_LOGS, of_disk(DISK, problem="Read-only file system")),
    (computer.NO_STATE, of_disk(STATE, problem="Permission denied")),
    (computer.FULL, of_disk(DISK, free_MB=199.0)),
    (computer.SLOW, of_disk(DISK, took_s=0.51)),
    (network.NO_PAGE, of_page(address="")),
    (network.PAGE, of_page()),
    (network.PAGE_TAKEN, of_page(problem="Address already in use", held_by=(OTHER,))),
    (network.PAGE_SERVED, of_page(service_runs=True, problem="Address already in use")),
    (network.NO_BROKER, of_broker(broker="")),
    (network.BROKER, of_broker(took_s=0.02)),
    (network.NO_PACKAGE, of_broker(problem="aiomqtt is missing", missing_package=True)),
    (network.AWAY, of_broker(problem="nothing answers there")),
    (network.REFUSES, of_broker(problem="it does not accept this user and password", needs_person=True)),
    (computer.ON_TIME, [computer.check_load(0.004, 0.3)]),
    (computer.BUSY, [computer.check_load(0.15, 0.3)]),
    (computer.TOO_BUSY, [computer.check_load(0.34, 0.3)]),
    (ports.GOOD, of_port()),
    (ports.NETWORK, [ports.check_network("phloSAR", "tcp:board:3000", False, None)]),
    (ports.FREE, [ports.check_network("phloSAR", "udpin:127.0.0.1:3000", True, None)]),
    (ports.MISSING, of_port(missing="/dev/ttyACM0 is not there")),
    (ports.NO_UART, of_port(where="serial:/dev/ttyAMA0:57600", missing="/dev/ttyAMA0 does not exist")),
    (ports.NOT_ALLOWED, of_port(may_open=False)),
    (ports.LOG_IN_AGAIN, of_port(may_open=False, member_since_login=True)),
    (ports.HELD, of_port(held_by=(OTHER,))),
    (ports.SERVED, of_port(held_by=(OTHER,), served=True)),
    (ports.SERVED, [ports.check_network("phloSAR", "udpin:127.0.0.1:3000", True, (OTHER,), served=True)]),
    (ports.CONSOLE, of_port(console=True)),
    (ports.MODEM, of_port(modem_manager=True)),
    (ports.KEPT_OFF, of_port(modem_manager=True, modem_manager_kept_off=True)),
    (ports.BY_NUMBER, of_port(where="serial:/dev/ttyACM0:115200", usb="usb:16c0:0483:77")),
    (processes.NO_SERVICE, [processes.check_service([], [])]),
    (processes.ELSEWHERE, [processes.check_service([OTHER], [])]),
    (processes.RUNS, [processes.check_service([OTHER], [OTHER])]),
    (firmware.NO_PORT, firmware.check(None, CONFIG)),
    (
        firmware.OTHER,
        firmware.check(
            None, configuration.parse(configuration.default_text().replace('"phlosar"', '"air_pump"'), "")
        ),
    ),
    (firmware.NO_ANSWER, of_firmware(welcome=None, port="the port is open but silent")),
    (firmware.GOOD, of_firmware()),
    (firmware.FAULTS, of_firmware(faults=Fault.CV_SENSOR | Fault.SUPPLY)),
    (firmware.RESTARTED, of_firmware(restarts=2)),
    (firmware.RATE, of_firmware()),
    (firmware.NO_TELEMETRY, of_firmware(telemetry_Hz=0.0)),
    (firmware.SLOW, of_firmware(telemetry_Hz=79.0)),
    (firmware.LOSSES, of_firmware(bad_frames=2)),
    (firmware.LOSSES, of_firmware(gaps=2)),
    (firmware.FAR, of_firmware(round_trip_s=0.11)),
    (firmware.SETTINGS, of_firmware()),
    (firmware.SOME_SETTINGS, of_firmware(settings=(replace(SETTING, count=19),) * 8)),
    (firmware.OWN_SETTINGS, of_firmware(settings=(replace(SETTING, value=25.0),))),
    (
        firmware.NO_SETTINGS,
        of_firmware(settings_problem="the firmware does not answer requests for settings"),
    ),
    (firmware.NEW_SETTINGS, of_firmware()),
    (firmware.KNOWN_SETTINGS, firmware.check(FIRMWARE, CONFIG, 77)),
    (firmware.KNOWN_SETTINGS, firmware.check(with_memory(SettingsMemory.ERASED), CONFIG, 77)),
    (firmware.OTHER_SETTINGS, firmware.check(FIRMWARE, CONFIG, 78)),
    (firmware.ERASED_SETTINGS, firmware.check(with_memory(SettingsMemory.ERASED), CONFIG)),
    (firmware.ERASED_SETTINGS, firmware.check(with_memory(SettingsMemory.ERASED), CONFIG, 78)),
    (firmware.DAMAGED_SETTINGS, firmware.check(with_memory(SettingsMemory.DAMAGED), CONFIG, 77)),
    (firmware.LIMITS, of_firmware()),
    (firmware.LOW_SETPOINTS, of_welcome(setpoint_limit_kPa=20.0, cv_limit_kPa=22.0)),
    (firmware.VENTS_FIRST, of_welcome(setpoint_limit_kPa=22.0, cv_limit_kPa=24.0)),
    (firmware.LOW_RESERVOIR, of_welcome(reservoir_limit_kPa=600.0)),
    (firmware.LOW_RATE, of_welcome(rate_limit_kPa_per_s=50.0)),
    (firmware.VINE, of_firmware(cv_kPa=-3.9)),
    (firmware.VINE_OFF, of_firmware(cv_kPa=4.1)),
    (firmware.VINE_OFF, of_firmware(cv_kPa=math.nan)),
    (firmware.RESERVOIR, of_firmware()),
    (firmware.RESERVOIR, of_firmware(reservoir_kPa=66.0, full_bend_spends_kPa=5.0)),
    (firmware.RESERVOIR_EMPTY, of_firmware(reservoir_kPa=60.0)),
    (firmware.RESERVOIR_EMPTY, of_firmware(reservoir_kPa=65.0, full_bend_spends_kPa=5.0)),
    (firmware.RESERVOIR_LOW, of_firmware(cycles_left=replace(FIRMWARE.cycles_left, expected=9.0))),  # type: ignore[type-var]
    (firmware.RESERVOIR_SENSOR, of_firmware(reservoir_kPa=-20.0)),
    (firmware.RESERVOIR_SENSOR, of_firmware(reservoir_kPa=math.nan)),
    (firmware.RESERVOIR_OVER, of_firmware(reservoir_kPa=730.0)),
    (firmware.RESERVOIR_LOSES, of_firmware(reservoir_falls_kPa_per_s=0.6)),
    (vehicle.NOT_ASKED, vehicle.check(None, CONFIG, 6.0)),
    (vehicle.NO_LINK, of_vehicle(messages=0, bytes=0, down="tcp:router:5760: Connection refused")),
    (vehicle.SILENT, of_vehicle(messages=0, bytes=0)),
    (vehicle.NOT_THE_PEER, vehicle.check(VehicleFacts(unread_from="10.0.0.8"), CONFIG, 6.0)),
    (vehicle.NOISE, of_vehicle(messages=0)),
    (vehicle.ECHO, of_vehicle(messages=0, echoes=7)),
    (vehicle.SERIAL_ECHO, of_vehicle(changed("vehicle", link="serial:/dev/ttyAMA0"), echoes=7)),
    (vehicle.BUFFER, of_vehicle(messages=2400, buffered=1260)),
    (vehicle.SMALL_BUFFER, of_vehicle(messages=2400, buffered=512)),
    (vehicle.NO_AUTOPILOT, of_vehicle(system_id=0, others=((255, 190),))),
    (vehicle.TWO_AUTOPILOTS, of_vehicle(system_id=0, rivals=(1, 2))),
    (vehicle.AUTOPILOT, of_vehicle()),
    (vehicle.OTHER_AUTOPILOT, of_vehicle(kind="other")),
    (vehicle.ARMED, of_vehicle(armed=True)),
    (vehicle.HEARTBEAT, of_vehicle()),
    (vehicle.HEARTBEAT_GAPS, of_vehicle(longest_silence_s=3.1)),
    (vehicle.NO_HEARTBEAT, of_vehicle(heartbeat_missing=True)),
    (vehicle.STREAM, of_vehicle()),
    (vehicle.SLOW, of_stream("SYS_STATUS", 6.9)),
    (vehicle.TOO_SLOW, of_stream("RC_CHANNELS", 2.9)),
    (vehicle.TOO_SLOW, of_stream("GLOBAL_POSITION_INT", 0.4, kind="px4")),
    (vehicle.MISSING, of_stream("RC_CHANNELS", 0.0)),
    (vehicle.MISSING, of_stream("SYS_STATUS", 0.0, refused=True, kind="px4")),
    (vehicle.MISSED, of_stream("MISSION_CURRENT", 0.0)),
    (vehicle.DUPLICATE_ID, of_vehicle(duplicate_id=True)),
    (
        vehicle.DUPLICATE_ID_OF_SERVICE,
        vehicle.check(replace(VEHICLE, duplicate_id=True), CONFIG, 6.0, [SERVICE]),
    ),
    (
        vehicle.DUPLICATE_ID_OF_SERVICE,
        vehicle.check(replace(VEHICLE, others=((1, 191),)), CONFIG, 6.0, [SERVICE]),
    ),
    (vehicle.DUPLICATE_ID_ONCE, of_vehicle(others=((1, 154), (1, 191)))),
    (vehicle.SERVED, vehicle.check(VehicleFacts(), CONFIG, 6.0, [SERVICE])),
    (vehicle.SERVED, vehicle.check(VehicleFacts(messages=9, others=((1, 191),)), CONFIG, 6.0, [SERVICE])),
    (vehicle.FREE, of_vehicle(others=((1, 154), (255, 190)))),
    (vehicle.DATED_AHEAD, vehicle.check(VehicleFacts(refused=RefusedFrames(ahead=9)), CONFIG, 6.0)),
    (vehicle.UNSIGNED, of_vehicle(SIGNED, messages=0, refused=REFUSED)),
    (vehicle.SOME_REFUSED, of_vehicle(SIGNED, refused=REFUSED)),
    (vehicle.SIGNED, of_vehicle(SIGNED)),
    (vehicle.NO_KEY, of_vehicle(signs=True)),
    (vehicle.NO_KEY_NEEDED, of_vehicle(signs=True, answers=True)),
    (vehicle.NOT_SIGNED, of_vehicle()),
    (radio.NOT_USED, of_switch(config=changed("switch", positions=("", "")))),
    (radio.NOT_CHECKED, [radio.check_switch(None, CONFIG, False)]),
    (radio.NOT_TRUSTED, of_switch(problem="radio failsafe")),
    (radio.HIDES_LOSS, of_switch(hides_loss="FS_THR_ENABLE 0")),
    (radio.TWO_USES, of_switch(other_use="RC9_OPTION is 31")),
    (radio.BENDS_LATE, of_switch(bends_late=True)),
    (radio.UNSETTLED, of_switch(position=None)),
    (radio.NOT_MOVED, of_switch()),
    (radio.AT_BEND, of_switch(position=2, pulse_us=2000, seen=frozenset({2}))),
    (radio.ALL_SEEN, of_switch(seen=frozenset({0, 1, 2}))),
    (radio.SOME_SEEN, of_switch(asked=True, seen=frozenset({0, 2}))),
    (radio.NEVER_MOVED, of_switch(asked=True)),
    (vehicle.MISSION_NOT_READ, vehicle.check_mission(None, True, CONFIG)),
    (vehicle.NO_MISSION_READ, vehicle.check_mission(None, False, CONFIG)),
    (vehicle.NO_MISSION, of_mission()),
    (vehicle.NO_VINE, of_mission(HOME, WAYPOINT)),
    (vehicle.UNDERSTOOD, of_mission(HOME, (SCRIPT, 1.0, 40.0))),
    (vehicle.NOT_UNDERSTOOD, of_mission(HOME, (SCRIPT, 99.0, 0.0))),
    (vehicle.NOT_UNDERSTOOD, of_mission(HOME, (SCRIPT, 1.0, 400.0))),
    (computer.SYNCHRONISED, of_clock()),
    (computer.NOT_SYNCHRONISED, of_clock(synchronised=False)),
    (computer.NOT_SET, of_clock(unix_s=1_704_067_200.0)),
    (computer.JUMPED, of_clock(jumped_s=-0.6)),
    (computer.AGREES, of_clock(ahead_s=-1.9)),
    (computer.APART, of_clock(ahead_s=2.1)),
    (computer.APART_AND_SIGNED, of_clock(ahead_s=-61.0, signing=True)),
    (computer.VEHICLE_WITHOUT, of_clock()),
    (radio.ARMED, of_receiver(problem="armed")),
    (radio.NO_AUTOPILOT, of_receiver(problem="no autopilot")),
    (radio.NO_RC, of_receiver(problem="no RC", detail="no RC_CHANNELS yet")),
    (radio.NOT_GOOD, of_receiver(problem="RC not good", detail="radio failsafe")),
    (radio.NOT_THERE, of_receiver(problem="position", detail="1500 µs", target=2)),
    (radio.NOT_BACK, of_receiver(problem="not back", detail="radio failsafe")),
    (radio.GROUND_STATION, of_receiver(problem="ground station")),
    (radio.HIDDEN_BY, of_receiver(autopilot="ardupilot", hidden_by="FS_THR_ENABLE 0")),
    (radio.HIDDEN, of_receiver(losses=(UNSEEN,))),
    (radio.SLOW, of_receiver(losses=(later(HELD, 3.1), HELD_BENT))),
    (radio.SHOWS, of_receiver()),
    (radio.SHOWS_UNTIMED, of_receiver(losses=(replace(HELD, pressed=False),))),
    (radio.PARAMETERS, of_receiver()),
    (radio.NO_PARAMETERS, of_receiver()),
    (radio.HELD, of_receiver()),
    (radio.HARMLESS, of_receiver(losses=(replace(HELD_BENT, lost_us=1000),))),
    (radio.BENDS_UNSEEN, of_receiver(losses=(PRESET, PRESET))),
    (radio.BENDS_REPORTED, of_receiver(autopilot="ardupilot", losses=(later(PRESET, 0.3),))),
    (radio.BENDS, of_receiver(losses=(later(PRESET, 1.9),))),
    (radio.UNCLEAR, of_receiver(losses=(HELD_BENT, replace(PRESET, lost_us=1500)))),
]


def named(case: tuple[FindingText, list[DoctorFinding]]) -> str:
    return f"{case[0].check}-{case[0].what[:30]}"


@pytest.mark.parametrize(("line", "found"), CASES, ids=map(named, CASES))
def test_the_facts_call_for_the_line(line: FindingText, found: list[DoctorFinding]) -> None:
    assert any(matches(line, finding) for finding in found), found


@pytest.mark.parametrize(
    ("rate_Hz", "verdict"), [(1.0, "good"), (0.9, "good"), (0.5, "warning"), (0.0, "warning")]
)
def test_px4_sends_mission_current_at_its_own_times(rate_Hz: float, verdict: str) -> None:
    found = of_stream("MISSION_CURRENT", rate_Hz, refused=True, kind="px4")
    (finding,) = (finding for finding in found if finding.check == "MISSION_CURRENT")
    assert finding.verdict == verdict
    assert "refuses" not in finding.what and "extras.txt" not in finding.do


def test_the_way_to_end_a_service_is_that_of_the_running_one() -> None:
    assert "(sudo systemctl stop flying-vines.service)" in processes.check_service([SERVICE], [SERVICE]).do
    assert "(kill 7)" in processes.check_service([Process(7, "flying-vines run")], []).do


def test_no_line_is_without_a_case() -> None:
    untold = [line for line in every_line() if not any(line is told for told, _ in CASES)]
    assert untold == []


def test_each_port_names_its_own_link() -> None:
    (missing,) = of_port(which="vehicle", missing="/dev/ttyACM0 is not there")
    assert missing.check == "vehicle port" and "correct vehicle.link" in missing.do
    assert "correct firmware.link" in of_port(missing="/dev/ttyACM0 is not there")[0].do


HEALTHY: list[Sequence[DoctorFinding]] = [
    of_configuration(),
    of_machine(),
    of_disk(DISK),
    of_disk(STATE),
    of_page(),
    of_broker(took_s=0.01),
    of_port(),
    [processes.check_service([], [])],
    of_firmware(),
    of_vehicle(),
    of_switch(seen=frozenset({0, 1, 2})),
    of_mission(HOME, (SCRIPT, 1.0, 40.0)),
    of_clock(ahead_s=0.0),
]


def test_good_findings_have_no_other_text() -> None:
    findings = [finding for found in HEALTHY for finding in found]
    assert {finding.verdict for finding in findings} == {"good"}
    assert may_fly(findings)
    assert summary(findings) == "You may fly."


def test_only_what_is_bad_keeps_one_on_the_ground() -> None:
    good, warning, bad = (DoctorFinding("disk", verdict, "?") for verdict in ("good", "warning", "bad"))
    assert may_fly([good, warning])
    assert not may_fly([good, bad])
    assert summary([good, warning]) == "You may fly; 1 thing to check."
    assert summary([bad, good]) == "Do not fly: 1 thing to correct."
    assert summary([bad, bad, warning, warning]) == "Do not fly: 2 things to correct, and 2 things to check."


def test_a_slow_stream_is_reported_with_what_to_set() -> None:
    (slow,) = [f for f in of_stream("GLOBAL_POSITION_INT", 2.0) if f.verdict != "good"]
    assert slow.check == "GLOBAL_POSITION_INT"
    assert "2.0 a second, not 5" in slow.what
    assert "SRn_POSITION = 5" in slow.do
    (missing,) = [f for f in of_stream("RC_CHANNELS", 0.0, kind="px4") if f.verdict != "good"]
    assert "mavlink stream -d DEVICE -s RC_CHANNELS -r 20" in missing.do


def test_without_a_switch_rc_is_not_needed() -> None:
    config = changed("switch", positions=("", "", ""))
    streams = tuple(replace(s, rate_Hz=0.0) if s.name == "RC_CHANNELS" else s for s in VEHICLE.streams)
    assert may_fly(of_vehicle(config, streams=streams))
    assert not may_fly(of_vehicle(streams=streams))


def test_a_limit_that_is_too_low_is_reported_with_what_to_raise_it_to() -> None:
    (low,) = [f for f in of_welcome(setpoint_limit_kPa=20.0, cv_limit_kPa=22.0) if f.verdict == "bad"]
    assert "cv_limit_kPa=23" in low.do, "20.7 kPa and the margin of 2, rounded up"


@pytest.mark.parametrize(
    ("losses", "safe"),
    [
        ((HELD, HELD_BENT), True),
        ((PRESET, PRESET), True),
        ((HELD_BENT, PRESET), True),
        ((later(PRESET, 1.9),), False),
        ((UNSEEN,), False),
        ((later(HELD, 3.1),), False),
    ],
)
def test_a_receiver_is_safe_if_the_loss_is_reported_before_a_bend(
    losses: tuple[TransmitterLoss, ...], safe: bool
) -> None:
    assert may_fly(of_receiver(losses=losses)) is safe


def test_on_ardupilot_nothing_waits_for_a_preset_that_is_reported_late() -> None:
    """ArduPilot's status changes 0.9 s after the jump, and the switch acts after `debounce_s`."""
    late = of_receiver(autopilot="ardupilot", losses=(PRESET,))
    assert any(matches(radio.BENDS, finding) for finding in late)
    assert not may_fly(late)


@pytest.mark.parametrize(
    ("learned", "written"),
    [
        (LEARNED, "hold"),
        (replace(LEARNED, losses=(PRESET, PRESET)), 2000),
        (replace(LEARNED, losses=(HELD_BENT, replace(PRESET, lost_us=1500))), "unknown"),
        (replace(LEARNED, losses=(UNSEEN,)), "hidden"),
        (replace(LEARNED, losses=(later(HELD, 3.1), HELD_BENT)), "hidden"),
        (replace(LEARNED, losses=(later(PRESET, 1.9), PRESET)), "hidden"),
        (replace(LEARNED, losses=(HELD,), problem="not back"), None),
        (replace(LEARNED, losses=(), hidden_by="FS_THR_ENABLE 0"), None),
    ],
)
def test_the_result_for_the_configuration(learned: RadioLearned, written: int | str | None) -> None:
    assert radio.to_write(learned, CONFIG) == written


@pytest.mark.parametrize("name", ["RC_CHANNELS", "GLOBAL_POSITION_INT"])
def test_a_slow_stream_is_not_the_autopilots_fault_while_this_computer_is_late(name: str) -> None:
    slow = replace(VEHICLE, streams=(StreamFacts(name, 20.0, 0.1, True, False),))

    def of(late_s: float) -> DoctorFinding:
        return next(f for f in vehicle.check(slow, CONFIG, 6.0, late_s=late_s) if f.check == name)

    assert of(0.01).verdict == "bad" and "SR" in of(0.01).do
    assert of(0.34).verdict == "warning"
    assert "SR" not in of(0.34).do and "busy" in of(0.34).do


async def test_the_doctor_measures_its_own_lateness() -> None:
    async def hang() -> None:
        for _ in range(7):
            await asyncio.sleep(0.03)
            time.sleep(0.2)  # noqa: ASYNC251  # the loop must hang

    hanging = asyncio.create_task(hang())
    assert await lateness_s(2.0) > 0.12
    await hanging

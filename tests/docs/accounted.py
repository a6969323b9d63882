"""What becomes of a command that is not simply run.

A key is its text, on one page alone with the page's name before it, or how it begins and `…`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """Tests that run it: what it is called and each of its options, or what `has` says, is in one of them."""

    tests: tuple[str, ...]
    has: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NotHere:
    """Why no test runs it."""

    because: str


@dataclass(frozen=True, slots=True)
class Ends:
    """It is run, and ends with another status than 0, as the page says."""

    status: int
    because: str


Accounted = Elsewhere | NotHere | Ends

ROOT_NEEDED = NotHere("changes the machine, as root")
NETWORK = NotHere("asks the package index over the network")
HOURS = NotHere("works for many minutes; its arguments are parsed by its own parser")
BOARD = NotHere("needs a board to flash, or its maker's tools")
PEER = NotHere("another program, on another machine or with people in front")

PAPER = Elsewhere(("tests/studies/test_paper_report.py",))
DIAGNOSED = Elsewhere(
    ("tests/identification/test_diagnose_command.py", "tests/identification/test_report.py")
)
PTY = Elsewhere(("tests/firmware/test_pty_firmware.py",), ("make", "phlosar-pty", "--link"))
OF_THE_README = Elsewhere(("README.md",))
FLOWN = Elsewhere(("tests/missions/test_mission_command.py",))
DOCTOR = Elsewhere(("tests/doctor/test_doctor_command.py", "tests/doctor/test_radio_command.py"))
"""Its status is this machine's: somebody may run a service on it meanwhile."""

ACCOUNTED: dict[str, Accounted] = {
    # Other programs.
    "make test": NotHere("this very test is of it"),
    "make demo": NotHere("sets up an environment over the network; the demo itself is run"),
    "make image": Elsewhere(("tests/firmware/conftest.py",), ("make", "image")),
    "make …": NotHere("what it would do is asked for, with -n"),
    "pip install …": NETWORK,
    "pip download …": NETWORK,
    "uv …": NETWORK,
    ". activate": NotHere("the tests' own environment is on"),
    "python -m build": Elsewhere(("tests/install/test_wheel.py",), ('"-m", "build"',)),
    "sudo …": ROOT_NEEDED,
    "systemctl …": ROOT_NEEDED,
    "journalctl …": ROOT_NEEDED,
    "pio run …": BOARD,
    "teensy_loader_cli …": BOARD,
    "ssh …": PEER,
    "mavproxy.py …": Elsewhere(("tests/peers/mavproxy.py",), ("mavproxy.py", "--master")),
    "mavlogdump.py …": NotHere("needs an autopilot's own log, of which there is none here"),
    "mosquitto_pub …": PEER,
    "mosquitto_sub …": PEER,
    "python benchmarks/…": HOURS,
    "make -C firmware_link/firmware/host && …": Elsewhere(
        ("tests/firmware/test_pty_firmware.py",), ("make", "phlosar-pty", "--link")
    ),
    # Ours, where it takes long.
    "flying-vines paper": PAPER,
    "flying-vines paper --out DIR --json": PAPER,
    "flying-vines paper --diagnose …": Elsewhere(("tests/studies/test_paper_diagnosis.py",)),
    "flying-vines diagnose CASE …": DIAGNOSED,
    "flying-vines diagnose CASE CASE …": Elsewhere(("tests/identification/test_many.py", *DIAGNOSED.tests)),
    "flying-vines diagnose season/first season/second": Elsewhere(("tests/identification/test_many.py",)),
    "flying-vines diagnose season/*": Elsewhere(("tests/identification/test_many.py",), ("diagnose",)),
    "flying-vines diagnose --from-log …": Elsewhere(
        ("tests/identification/test_from_log.py", *DIAGNOSED.tests)
    ),
    "flying-vines diagnose --plan …": Elsewhere(("tests/identification/test_plan.py",)),
    "flying-vines mission check FILE …": FLOWN,
    "flying-vines mission check bridge_inspection-ardupilot.plan --fly": FLOWN,
    "flying-vines mission check plans/canopy-px4.plan --fly": FLOWN,
    "commands.md: flying-vines diagnose leaky --out report --write-rig extended.toml": Elsewhere(
        ("README.md",)
    ),
    "flying-vines design --robot …": Elsewhere(("tests/studies/test_design_command.py",)),
    "flying-vines calibrate …": Elsewhere(("tests/calibration/test_calibrate_command.py",)),
    # Ours, where more is to be seen than a status.
    "sudo flying-vines install-service": Elsewhere(("tests/install/test_install_service.py",)),
    "flying-vines doctor …": DOCTOR,
    "flying-vines mission upload wrong.waypoints …": Ends(2, "the vehicle refuses one of its items"),
    "flying-vines mission check canopy_sampling-px4.plan --autopilot ardupilot": Ends(2, "it finds errors"),
}

MEANT = {
    r"--scenario (?:case|FILE)": "--scenario short.toml",
    r"--seed N": "--seed 1",
    r"mission upload FILE": r"mission upload canopy_sampling-ardupilot.plan",
    r"mission download FILE": r"mission download there.plan",
    r"--link LINK": "--link tcp:127.0.0.1:5760",
    r"--seconds \d+": "--seconds 1",
    r"replay FLIGHT --config FILE": "replay FLIGHT --config flown.toml",
    r"--config FILE": "--config vine.toml",
    r"config check FILE": "config check vine.toml",
    r"--vine FILE": "--vine my-vine.toml",
    r"--parts DIR": "--parts parts",
    r"(--in|list) DIR": r"\1 flights",
}
"""What a command is run with instead: a word for one in capitals, or less of what takes long."""

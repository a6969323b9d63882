"""A day in the life of a new user, in an empty folder: from the wheel to a simulation that explains the rig.

    .venv/bin/python tests/day/day_in_the_life.py --pictures DIR

It prints each step and its command, and saves a picture of each. Stand-ins for autopilot and phloSAR take the
place of the hardware. The stand-in's rig has a leak that the user's configuration does not know.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

# Run as a script, this file's own folder is on the path, but not tests/.
sys.path.insert(0, str(Path(__file__).parents[1]))

from ports import free_port

from day.terminal import Ended, Terminal

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).parents[2]
LEAK_KPA_S_PER_SL = 2000.0
RIG = f"[cv]\nvolume_L = 0.1\n[causes.cv_leak]\nflow_resistance_kPa_s_per_SL = {LEAK_KPA_S_PER_SL}\n"
SWITCH = 9
LOW, MIDDLE, HIGH = 1000, 1500, 2000
DESKTOP, PHONE, SMALL = (1440, 900), (360, 740), (320, 640)
READ = """\
import json
import numpy as np
from flying_vines import api

flight = api.read_flight("flights/last")
phlosar, decisions = flight["phlosar/telemetry"], flight["decision"]
accepted = decisions["safety"] == "accepted"
print(json.dumps({
    "rows": len(phlosar["cv_kPa"]),
    "peak_kPa": phlosar["cv_kPa"].max(),
    "setpoint_kPa": phlosar["setpoint_kPa"].max(),
    "last_kPa": phlosar["cv_kPa"][-100:].mean(),
    "intents": list(decisions["intent"][accepted]),
    "altitude_m": np.nanmax(flight["snapshot"]["altitude_m"]),
}))
"""
COMPARE = """\
import json
import numpy as np
from flying_vines import api
from flying_vines.physics.plant.compiled import replay
from flying_vines.physics.plant.plant import at_rest
from flying_vines.physics.plant.true_rig import TrueRig

flight = api.read_case("flights/last")
rigs = {"configured": TrueRig(flight.rig), "extended": api.load_rig("extended.toml")}


def misfit_kPa(rig):
    wrong = []
    for run in flight.runs:
        tick = np.round(1000 * (run.time_s - run.time_s[0])).astype(int)
        held = np.searchsorted(tick, np.arange(tick[-1] + 1), side="right") - 1
        openings = np.column_stack((run.evp_opening, run.dvp_opening, run.solenoid))[held]
        plant = rig.setup.plant
        simulated = replay(plant, openings, at_rest(plant, np.nanmean(run.reservoir_kPa[:500])))
        wrong.append(run.cv_kPa - simulated.table["cv_kPa"][tick])
    return float(np.sqrt(np.nanmean(np.concatenate(wrong) ** 2)))


print(json.dumps({name: misfit_kPa(rig) for name, rig in rigs.items()}))
"""


@dataclass
class Outcomes:
    """The results of the day, step by step."""

    installed: str = ""
    """Where the program was installed."""
    checked: str = ""
    doctor: str = ""
    calibrated: dict[str, Any] = field(default_factory=dict)
    """The findings of the calibration."""
    uploaded: str = ""
    page: str = ""
    """The text of the page while the vine was bent."""
    flown: str = ""
    """What `mission watch` printed."""
    shown: str = ""
    """What `log show` printed."""
    flight: dict[str, Any] = field(default_factory=dict)
    """What the user's script read from the recording."""
    replayed: str = ""
    verdict: dict[str, Any] = field(default_factory=dict)
    misfit_kPa: dict[str, float] = field(default_factory=dict)
    """Root mean square error of the simulation for the second flight, which no fit has used, by rig."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Time of each step."""


class Day:
    """A user at a terminal in `folder`, with an environment without the checkout."""

    def __init__(self, folder: Path, pictures: Path, browser: Browser) -> None:
        self.folder = folder
        self.seen = Outcomes()
        self._pictures = pictures
        self._browser = browser
        self._environment = {
            "HOME": str(folder),
            "PATH": f"{folder / 'venv' / 'bin'}:{os.environ['PATH']}",
            "LANG": "C.UTF-8",
            # Use the machine's caches.
            "XDG_CACHE_HOME": os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache")),
        } | {name: value for name, value in os.environ.items() if name.startswith(("PIP_", "SSL_"))}
        if (config := Path.home() / ".config" / "pip" / "pip.conf").exists():
            self._environment.setdefault("PIP_CONFIG_FILE", str(config))
        self._count = 0
        self._shots: list[tuple[str, Path]] = []

    @contextmanager
    def step(self, title: str) -> Iterator[None]:
        print(f"\n== {title}", flush=True)
        began = time.monotonic()
        yield
        self._draw()
        self.seen.seconds[title] = time.monotonic() - began
        print(f"   {self.seen.seconds[title]:.0f} s", flush=True)

    def open(self, line: str, size: tuple[int, int] = (100, 32)) -> Terminal:
        """Begin a command in a terminal of its own."""
        print(f"   $ {line}", flush=True)
        return Terminal(("sh", "-c", f"exec {line}"), self.folder, self._environment, size)

    def do(self, line: str, picture: str = "") -> str:
        """Run a command to its end. Returns its output."""
        with self.open(line) as terminal:
            said = terminal.end()
            if picture:
                self.picture(terminal, picture, line)
        return said

    def picture(self, terminal: Terminal, name: str, title: str) -> None:
        """Take a picture of the terminal. It is drawn at the end of the step, because a flight needs the
        processor."""
        self._shots.append((terminal.svg(title), self._path(name)))

    def _draw(self) -> None:
        for svg, path in self._shots:
            page = self._browser.new_page(viewport={"width": 1240, "height": 100})
            page.set_content(f"<body style='margin:0'>{svg}</body>")
            page.screenshot(path=path, full_page=True)
            page.close()
        self._shots.clear()

    def _path(self, name: str) -> Path:
        """Path of the next picture."""
        self._count += 1
        path = self._pictures / f"{self._count:02d}-{name}.png"
        print(f"   picture {path}", flush=True)
        return path

    def keep(self, picture: Path) -> None:
        """Save a picture that a command has drawn."""
        shutil.copy(picture, self._path(picture.stem))

    @contextmanager
    def page(self, url: str) -> Iterator[Page]:
        page = self._browser.new_page()
        page.goto(url)
        page.wait_for_selector("body:not(.stale)")
        yield page
        page.close()

    def shoot(self, page: Page, name: str, *sizes: tuple[int, int]) -> None:
        """Save a page in windows of these sizes."""
        for width, height in sizes:
            page.set_viewport_size({"width": width, "height": height})
            page.screenshot(path=self._path(f"{name}-{width}"))


def live(folder: Path, pictures: Path, browser: Browser) -> Outcomes:
    """Run the whole day."""
    day = Day(folder, pictures, browser)
    seen = day.seen
    ports = {name: free_port() for name in ("vehicle", "gcs", "page")}
    with day.step("Build the wheel and install it"):
        _install(day)
    with day.step("A configuration"):
        day.do("flying-vines config init vine.toml")
        use_stand_ins(folder / "vine.toml", ports["vehicle"], ports["page"])
        seen.checked = day.do("flying-vines config check vine.toml", "config-check")

    # The stand-ins run for the whole day.
    (folder / "hidden.toml").write_text(RIG, encoding="utf-8")
    with ExitStack() as around:
        with day.step("The stand-ins for the hardware"):
            to_both = f"--to 127.0.0.1:{ports['vehicle']} --gcs 127.0.0.1:{ports['gcs']}"
            line = "flying-vines fake phlosar --link vine-port --rig hidden.toml --telemetry-Hz 1000"
            phlosar = around.enter_context(day.open(line))
            phlosar.wait_for("Type a failure")
            autopilot = around.enter_context(day.open(f"flying-vines fake autopilot {to_both}"))
            autopilot.wait_for("Ctrl-C ends it")
            day.picture(autopilot, "fake-autopilot", "flying-vines fake autopilot")
        with day.step("May one fly?"):
            seen.doctor = _doctor(day, autopilot)
        with day.step("Calibrate"):
            _calibrate(day)
        with day.step("A mission, watched on the page"):
            _mission(day, autopilot, ports)
        with day.step("Look at the flight"):
            _look(day)
        with day.step("Why does the rig differ from the simulation?"):
            _diagnose(day)
        with day.step("A second flight, with the extended rig"):
            _fly_by_hand(day, autopilot)
        with day.step("Does the extended rig explain it?"):
            _compare(day)
    return seen


def use_stand_ins(config_file: Path, vehicle_port: int, page_port: int) -> None:
    """Point the links of a new configuration at stand-ins: the phloSAR's port is `vine-port` beside it."""
    text = config_file.read_text(encoding="utf-8")
    for old, new in (
        ("udpin:127.0.0.1:14540", f"udpin:127.0.0.1:{vehicle_port}"),
        ("serial:/dev/ttyACM0", "serial:vine-port"),
        ("port = 8017", f"port = {page_port}"),
    ):
        assert old in text
        text = text.replace(old, new)
    config_file.write_text(text, encoding="utf-8")


def _install(day: Day) -> None:
    folder = day.folder
    day.do(f"{sys.executable} -m build --no-isolation --wheel --outdir dist {_sources(folder)}")
    day.do(f"{sys.executable} -m venv venv")
    (wheel,) = (folder / "dist").glob("*.whl")
    day.do(f"venv/bin/pip install --quiet --disable-pip-version-check '{wheel}[analysis,missions]'")
    day.seen.installed = day.do("python -I -c 'import flying_vines; print(flying_vines.__file__)'").strip()


def _sources(folder: Path) -> Path:
    """A copy of the checkout, because a build leaves folders there."""
    copy = folder / "sources"
    copy.mkdir()
    for name in ("firmware_link", "flying_vines", "missions"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", "build"))
    for name in ("LICENSE", "MANIFEST.in", "README.md", "pyproject.toml"):
        shutil.copy(ROOT / name, copy / name)
    return copy


def _doctor(day: Day, autopilot: Terminal) -> str:
    line = "flying-vines doctor --config vine.toml"
    with day.open(line) as doctor:
        doctor.wait_for("Move the switch")
        for pulse_us in (MIDDLE, HIGH, LOW):
            autopilot.type(f"rc {SWITCH} {pulse_us}")
            time.sleep(1.5)
        said = doctor.end()
        day.picture(doctor, "doctor", line)
    return said


def _calibrate(day: Day) -> None:
    line = "flying-vines calibrate --config vine.toml --only vine_leak --yes --no-diagnosis"
    day.do(line, "calibrate")
    (found,) = day.folder.glob("flights/*/calibration/findings.json")
    day.seen.calibrated = json.loads(found.read_text(encoding="utf-8"))


def _mission(day: Day, autopilot: Terminal, ports: dict[str, int]) -> None:
    day.do("flying-vines mission example canopy_sampling")
    built = "flying-vines mission build canopy_sampling.toml --autopilot ardupilot --config vine.toml"
    day.do(built, "mission-build")
    link = f"--link udpin:127.0.0.1:{ports['gcs']}"
    day.seen.uploaded = day.do(f"flying-vines mission upload canopy_sampling-ardupilot.plan {link}")
    line = "flying-vines run --config vine.toml"
    watched = f"flying-vines mission watch {link}"
    url = f"http://127.0.0.1:{ports['page']}/"
    with day.open(line) as run, day.open(watched) as watch:
        run.wait_for("phloSAR ready")
        watch.wait_for("Watching")
        _wait_for_port(ports["page"])
        with day.page(url) as page:
            autopilot.type("mission")
            run.wait_for("bend 50°: accepted")
            time.sleep(1.0)
            day.picture(run, "run", line)
            day.seen.page = page.inner_text("body")
            day.shoot(page, "page", DESKTOP, PHONE, SMALL)
        run.wait_for("wave: accepted")
        day.picture(watch, "mission-watch", watched)
        day.seen.flown = watch.end()
        _stop(run)


def _wait_for_port(port: int) -> None:
    while True:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)


def _stop(run: Terminal) -> None:
    run.interrupt()
    if "Vented. Stopped." not in run.end():
        raise Ended(f"not vented: {run.output}")


def _look(day: Day) -> None:
    day.seen.shown = day.do("flying-vines log show last", "log-show")
    day.do("flying-vines log plot last -o flight.png")
    day.keep(day.folder / "flight.png")
    (day.folder / "read.py").write_text(READ, encoding="utf-8")
    day.seen.flight = json.loads(day.do("python read.py"))
    day.seen.replayed = day.do("flying-vines replay flights/last", "replay")


def _diagnose(day: Day) -> None:
    line = "flying-vines diagnose --from-log flights/last --out report --write-rig extended.toml"
    day.do(line, "diagnose")
    with day.page((day.folder / "report" / "report.html").as_uri()) as page:
        day.shoot(page, "report", DESKTOP)
    day.seen.verdict = json.loads((day.folder / "report" / "verdict.json").read_text(encoding="utf-8"))
    day.do("flying-vines simulate --rig extended.toml --scenario case --out cases/extended")
    day.keep(day.folder / "cases" / "extended" / "picture.png")


def _fly_by_hand(day: Day, autopilot: Terminal) -> None:
    line = "flying-vines run --config vine.toml --rig extended.toml"
    with day.open(line) as run:
        run.wait_for("phloSAR ready")
        autopilot.type("mode LOITER")
        autopilot.type("arm")
        autopilot.type("takeoff 10")
        time.sleep(6.0)
        for pulse_us, seconds in ((MIDDLE, 4.0), (HIGH, 4.0), (LOW, 5.0), (HIGH, 3.0), (LOW, 6.0)):
            autopilot.type(f"rc {SWITCH} {pulse_us}")
            time.sleep(seconds)
        day.picture(run, "run-extended", line)
        autopilot.type("land")
        _stop(run)


def _compare(day: Day) -> None:
    (day.folder / "compare.py").write_text(COMPARE, encoding="utf-8")
    day.seen.misfit_kPa = json.loads(day.do("python compare.py"))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--pictures", type=Path, required=True, metavar="DIR", help="the folder for the pictures"
    )
    arguments = parser.parse_args()
    arguments.pictures.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="vines-") as folder, browser() as opened:
        seen = live(Path(folder), arguments.pictures.resolve(), opened)
    total_s = sum(seen.seconds.values())
    print(f"\nMisfit of the second flight: {seen.misfit_kPa} kPa rms. The day took {total_s:.0f} s.")


@contextmanager
def browser() -> Iterator[Browser]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        opened = started.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        yield opened
        opened.close()


if __name__ == "__main__":
    main()

"""Redraws the pictures of the guides: of commands, of flights with stand-ins, and of the page in a browser.

    .venv/bin/python docs/redraw.py [PICTURE ...]     # without a name: all, in about eight minutes

It needs the extra `dev` and Chromium. `architecture.svg` and `wiring.svg` are drawn by hand.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import socket
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import pyplot as plt
from PIL import Image
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from day.day_in_the_life import browser, use_stand_ins
from day.terminal import Terminal
from ports import free_port

from flying_vines.identification.bend_curve import Law
from flying_vines.plots.style import BLUE, GREEN, GREY, ORANGE, PURPLE, finish

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(DOCS.parent)}
COLOURS = 256
LOW, MIDDLE, HIGH = 1000, 1500, 2000
OUR_ID = 191

Draw = Callable[[Path, "Browser"], None]
"""Draws pictures into a folder."""


def start(line: str, folder: Path, size: tuple[int, int] = (100, 32)) -> Terminal:
    """Start a `flying-vines` command on a terminal."""
    return Terminal(("sh", "-c", f"exec {sys.executable} -m flying_vines {line}"), folder, ENVIRONMENT, size)


def run(line: str, folder: Path) -> None:
    """Run a `flying-vines` command to its end."""
    with start(line, folder) as terminal:
        terminal.end()


def commands(*lines: str, **files: str) -> Draw:
    """Run these `flying-vines` commands. `files`: for each picture, the file that a command writes."""

    def draw(folder: Path, browser: Browser) -> None:
        _write_inputs(folder)
        for line in lines:
            run(line, folder)
        for picture, file in files.items():
            (written,) = folder.glob(file)
            target = folder / f"{picture.replace('_', '-')}.png"
            if written.suffix == ".svg":
                page = browser.new_page(device_scale_factor=1.5)
                page.set_content(f"<body style='margin:0'>{written.read_text(encoding='utf-8')}</body>")
                page.locator("svg").first.screenshot(path=target)
                page.close()
            else:
                shutil.copy(written, target)

    return draw


def measured(name: str, files: str) -> Draw:
    """Import and diagnose readings of another laboratory, as in docs/measured-data.md."""
    return commands(
        f"import measured/{files} --to case",
        "diagnose case --out report",
        **{f"measured_{name}": "report/run-1.svg"},
    )


def _write_inputs(folder: Path) -> None:
    """Write the files that the commands read."""
    # A copy: the import writes its answers beside the data.
    shutil.copytree(DOCS.parent / "tests" / "data" / "measured", folder / "measured")
    small, heats = "[cv]\nvolume_L = 0.1\n", "[causes.cv_heating]\ntime_constant_s = 5.6\n"
    (folder / "large.toml").write_text("[cv]\nvolume_L = 0.5\n")
    (folder / "small.toml").write_text(small)
    (folder / "heating.toml").write_text(small + heats)
    guide = (DOCS / "simulate.md").read_text(encoding="utf-8")
    (scenario,) = (block for block in re.findall(r"```toml\n(.*?)```", guide, re.DOTALL) if "chirp" in block)
    (folder / "commands.toml").write_text(scenario)
    up_kPa = np.linspace(0.0, 20.7, 24)
    kPa = np.concatenate([up_kPa, up_kPa[::-1], up_kPa[::3]])
    noise = np.random.default_rng(1).normal(0.0, 0.7, kPa.size)
    degrees = Law(75.0, 2.5, 11.0, 2.2).angles_deg(kPa) + noise
    pairs = "".join(f"{p:.2f},{angle:.1f}\n" for p, angle in zip(kPa, degrees, strict=True))
    (folder / "pairs.csv").write_text(f"pressure_kPa,angle_deg\n{pairs}")


def page_of(browser: Browser, port: int, **window: Any) -> Page:
    """The service's page in a new window, as soon as it shows data."""
    while True:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                break
        sleep(0.1)
    page = browser.new_page(**window)
    page.goto(f"http://127.0.0.1:{port}/")
    page.wait_for_selector("body:not(.stale)")
    return page


def page(folder: Path, browser: Browser) -> None:
    """The demo's page on a phone while the vine is bent, and on a laptop during a fault."""
    with start("demo --page --plain", folder) as flight:
        port = int(flight.wait_for(r"http://[\d.]+:(\d+)/").group(1))
        phone = page_of(browser, port, viewport={"width": 360, "height": 640}, device_scale_factor=1.5)
        laptop = page_of(browser, port, viewport={"width": 1440, "height": 900})
        # A phone has no keys.
        phone.evaluate("document.querySelector('#vent small').remove()")
        phone.wait_for_function("() => Number(document.querySelector('#bend').textContent) > 55")
        phone.screenshot(path=folder / "page-phone.png")
        flight.wait_for("reservoir loss → vent")
        flight.wait_for("refused")
        laptop.wait_for_timeout(500)
        laptop.screenshot(path=folder / "page-desktop.png")
        flight.end()


class StandIns:
    """Context manager: stand-ins for autopilot and phloSAR, and a configuration for them."""

    def __init__(self, folder: Path, gcs_port: int, options: str = "") -> None:
        self.vehicle_port, self.page_port = free_port(), free_port()
        run("config init vine.toml", folder)
        use_stand_ins(folder / "vine.toml", self.vehicle_port, self.page_port)
        to_both = f"--to 127.0.0.1:{self.vehicle_port} --gcs 127.0.0.1:{gcs_port}"
        with ExitStack() as stack:
            self.phlosar = stack.enter_context(start(f"fake phlosar --link vine-port {options}", folder))
            self.autopilot = stack.enter_context(start(f"fake autopilot {to_both}", folder))
            self.phlosar.wait_for("Type a failure")
            self.autopilot.wait_for("Ctrl-C ends it")
            self._stack = stack.pop_all()

    def __enter__(self) -> StandIns:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def switch(self, pulse_us: int) -> None:
        self.autopilot.type(f"rc 9 {pulse_us}")


class GroundStation:
    """Collects the vine's values, and sends commands to it."""

    def __init__(self) -> None:
        self.port = free_port()
        self.values: dict[str, list[tuple[float, float]]] = {}
        """Pairs of time and value, by name."""
        self._link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{self.port}", source_system=255)
        self._began = self._spoke = monotonic()

    def listen(self, seconds: float) -> None:
        until = monotonic() + seconds
        while (now := monotonic()) < until:
            if now > self._spoke + 1.0:
                self._spoke = now
                self._link.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            message = self._link.recv_match(type="NAMED_VALUE_FLOAT", blocking=True, timeout=0.2)
            if message is not None:
                self.values.setdefault(message.name, []).append((now - self._began, message.value))

    def ask(self, command: int, value: float) -> None:
        self._link.mav.command_long_send(1, OUR_ID, command, 0, value, 0, 0, 0, 0, 0, 0)

    def draw(self, path: Path) -> None:
        figure, axes = plt.subplots(3, 1, sharex=True, figsize=(9.0, 6.2), layout="constrained")
        cycles = axes[2].twinx()
        for axis, unit, lines in (
            (axes[0], "kPa gauge", {"CMD_KPA": GREY, "CV_KPA": BLUE}),
            (axes[1], "°", {"BEND_DEG": PURPLE}),
            (axes[2], "kPa gauge", {"RES_KPA": ORANGE}),
            (cycles, "cycles", {"CYC_LEFT": GREEN}),
        ):
            for name, colour in lines.items():
                axis.plot(*zip(*self.values[name], strict=True), color=colour, label=name)
            axis.set_ylabel(unit)
            axis.legend(loc="center right" if axis is cycles else "center left", frameon=False)
        axes[2].set_xlabel("s")
        finish(figure, "What a ground station received in one session on the bench")
        cycles.grid(visible=False)
        figure.savefig(path, dpi=100)


def bench(folder: Path, browser: Browser) -> None:
    """The tutorial's session on the bench, as recorded and as a ground station sees it."""
    ground = GroundStation()
    with (
        StandIns(folder, ground.port) as there,
        start("run --config vine.toml --plain", folder) as service,
    ):
        service.wait_for("serving vehicle")
        shown = page_of(browser, there.page_port)
        ground.listen(2.0)
        for pulse_us in (HIGH, LOW):
            there.switch(pulse_us)
            ground.listen(2.0)
        shown.click("#bench-mode")
        for pulse_us in (MIDDLE, HIGH):
            ground.listen(2.0)
            there.switch(pulse_us)
            ground.listen(3.0)
        there.phlosar.type("hose off")
        ground.listen(4.0)
        there.phlosar.type("hose well")
        for pulse_us in (LOW, MIDDLE, LOW):
            there.switch(pulse_us)
            ground.listen(4.0)
        for command, value in (
            (mavlink.MAV_CMD_USER_2, 30.0),
            (mavlink.MAV_CMD_USER_3, 500.0),
            (mavlink.MAV_CMD_USER_2, 95.0),
            (mavlink.MAV_CMD_USER_4, 0.0),
        ):
            ground.ask(command, value)
            ground.listen(4.0)
        service.interrupt()
        service.end()
    ground.draw(folder / "ground-station-graph.png")
    run("log plot last -o tutorial-bench.png", folder)


def doctor(folder: Path, browser: Browser) -> None:
    """The doctor with an empty reservoir, while another program has our component id."""
    other = mavlink.MAVLink(None, srcSystem=1, srcComponent=OUR_ID)
    with StandIns(folder, free_port(), "--reservoir-kPa 30") as there:
        link = mavutil.mavudp(f"127.0.0.1:{there.vehicle_port}", input=False)
        with start("doctor --config vine.toml --yes", folder, (100, 48)) as terminal:
            while "Do not fly" not in terminal.output:
                other.seq = (other.seq + 1) % 256
                link.write(
                    mavlink.MAVLink_heartbeat_message(
                        mavlink.MAV_TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 4, 3
                    ).pack(other)
                )
                sleep(0.1)
            terminal.end(status=1)
            svg = terminal.svg("flying-vines doctor")
    (folder / "doctor.svg").write_text(svg, encoding="utf-8")


PAPER = ("discharge", "inflation", "frequency", "sine", "cycles")
CALIBRATION = ("levels", "valve", "reservoir", "angle")
MEASURED = {
    "leak": "leaking_chambers/Ultimaker_020.csv",
    "plenum": "plenum_discharge/*.csv",
    "pump": "pump_and_chamber/sweep_response_20260121_165542.csv",
}
SHEETS: dict[tuple[str, ...], Draw] = {
    ("page-phone.png", "page-desktop.png"): page,
    ("demo-flight.png",): commands("demo --plain", demo_flight="flights/*/flight.png"),
    ("tutorial-bench.png", "ground-station-graph.png"): bench,
    ("doctor.svg",): doctor,
    ("vine-fit.png",): commands("vine fit pairs.csv --out ."),
    ("design-speed.png", "design-search.png"): commands("design --out ."),
    tuple(f"paper-{name}.png" for name in PAPER): commands("paper --out ."),
    ("paper-diagnosis-discharge.png", "paper-diagnosis-frequency.png"): commands("paper --diagnose --out ."),
    ("simulate-case.png",): commands(
        "simulate --rig large.toml --scenario case --out case", simulate_case="case/picture.png"
    ),
    ("simulate-commands.png",): commands(
        "simulate --rig small.toml --scenario commands.toml --out case", simulate_commands="case/picture.png"
    ),
    ("diagnose-run.png", "diagnose-residuals.png", "diagnose-likeness.png"): commands(
        "simulate --rig heating.toml --scenario case --out case",
        "diagnose case --out report",
        diagnose_run="report/run-4.svg",
        diagnose_residuals="report/residuals.svg",
        diagnose_likeness="report/likeness.svg",
    ),
    **{(f"measured-{name}.png",): measured(name, files) for name, files in MEASURED.items()},
    ("plan-matrix.png",): commands("diagnose --plan large.toml --minutes 1 --out ."),
    tuple(f"calibrate-{name}.png" for name in CALIBRATION): commands(
        "calibrate --fake --yes --no-diagnosis --out flights",
        **{f"calibrate_{name}": f"flights/*/calibration/{name}.png" for name in CALIBRATION},
    ),
}
"""Pictures that are drawn together."""


def keep(drawn: Path) -> None:
    """Copy the picture to docs/images; a PNG with few colours."""
    target = IMAGES / drawn.name
    if drawn.suffix == ".png":
        Image.open(drawn).convert("RGB").quantize(COLOURS).save(target, optimize=True)
    else:
        shutil.copy(drawn, target)
    print(f"{target}  {target.stat().st_size / 1000:.0f} kB", flush=True)


def redraw(wanted: Sequence[str]) -> None:
    with browser() as opened:
        for names, draw in SHEETS.items():
            chosen = [name for name in names if not wanted or name in wanted]
            if chosen:
                with TemporaryDirectory() as folder:
                    draw(Path(folder), opened)
                    for name in chosen:
                        keep(Path(folder) / name)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    known = sorted(name for names in SHEETS for name in names)
    parser.add_argument("pictures", nargs="*", metavar="PICTURE", help=", ".join(known))
    wanted = parser.parse_args().pictures
    if unknown := set(wanted) - set(known):
        parser.error(f"no such picture: {', '.join(sorted(unknown))}")
    redraw(wanted)


if __name__ == "__main__":
    main()

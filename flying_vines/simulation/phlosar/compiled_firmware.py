"""The real firmware's core, built for this machine, behind the same few calls as the emulated one.

What a lab flashes is what runs here: its C++ is compiled once, kept under the user's cache by what it is made
of, and loaded. Only the board is not there: pressures become the counts of its converter, duty cycles the
openings of its valves.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Literal

from firmware_link.protocol import Fault, Mode
from flying_vines.simulation.phlosar.firmware_settings import (
    SENSOR_BEYOND_SPAN,
    SETTING_ROWS,
    CV_SENSOR_SPAN_kPa,
    FirmwareSettings,
    RESERVOIR_SENSOR_SPAN_kPa,
    value_of,
    with_value,
)
from flying_vines.simulation.phlosar.regulator import Drive, RegulatorSettings

SOURCES = Path(__file__).parents[3] / "firmware_link" / "firmware"
WHAT_TO_INSTALL = "a C++ compiler: sudo apt install g++"
_FLAGS = ("-std=c++17", "-O2", "-shared", "-fPIC", "-fno-exceptions", "-fno-rtti", "-ffp-contract=off")
_BUILD = "1.0 host"
_FULL_SCALE = 65535
_SUPPLY_COUNTS = 59578
"""5 V through the divider of 0.6 into the converter of 3.3 V."""
_OUTPUT_BYTES = 1024


class FirmwareBuildError(Exception):
    """The C++ sources could not be built here; says why in a sentence."""


def compiler() -> str | None:
    """The C++ compiler of this machine ($CXX comes first), or None."""
    for name in (os.environ.get("CXX"), "c++", "g++", "clang++"):
        if name and (path := shutil.which(name)):
            return path
    return None


def build(real: Literal["float", "double"] = "float") -> Path:
    """The shared library, built unless it is in the cache. `float` is what the chip computes with.

    FirmwareBuildError when there is no compiler, or it fails.
    """
    command = compiler()
    if command is None:
        raise FirmwareBuildError(f"the firmware cannot be built here without {WHAT_TO_INSTALL}")
    library = SOURCES / "host" / "library.cpp"
    return built((command, *_FLAGS, f"-DPHLOSAR_REAL={real}"), (*core_files(), library), "phlosar.so")


def core_files() -> list[Path]:
    """The portable core's sources and headers."""
    core = SOURCES / "phlosar" / "src" / "core"
    return sorted([*core.glob("*.h"), *core.glob("*.cpp")])


def built(command: Sequence[str], files: Sequence[Path], name: str) -> Path:
    """What the command makes of these sources and headers: in the cache, under a name by all it is made of.

    FirmwareBuildError when it fails, or when there can be no cache.
    """
    made_of = hashlib.sha256("\0".join(command).encode())
    for file in files:
        made_of.update(file.read_bytes())
    cache_folder = _cache_folder()
    kept = cache_folder / f"{Path(name).stem}-{made_of.hexdigest()[:16]}{Path(name).suffix}"
    if not kept.exists():
        sources = [str(file) for file in files if file.suffix == ".cpp"]
        # Under a name of its own until it is whole: two processes may build at once.
        with tempfile.TemporaryDirectory(dir=cache_folder) as folder:
            fresh = Path(folder) / kept.name
            made = subprocess.run(
                [*command, "-o", str(fresh), *sources], capture_output=True, text=True, check=False
            )
            if made.returncode != 0:
                raise FirmwareBuildError(f"{command[0]} cannot build the firmware: {made.stderr.strip()}")
            fresh.replace(kept)
    return kept


def _cache_folder() -> Path:
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "flying-vines"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FirmwareBuildError(f"the firmware cannot be kept in {folder}: {error.strerror}") from None
    return folder


class _Outputs(ctypes.Structure):
    _fields_ = (("evp_duty", ctypes.c_uint16), ("dvp_duty", ctypes.c_uint16), ("solenoid", ctypes.c_bool))


class _Openings(ctypes.Structure):
    _fields_ = (("evp", ctypes.c_double), ("dvp", ctypes.c_double), ("solenoid", ctypes.c_bool))


@cache
def load(real: Literal["float", "double"] = "float") -> ctypes.CDLL:
    """The library's functions. FirmwareBuildError as `build`."""
    library = ctypes.CDLL(str(build(real)))
    here, u8, u16, u32, size = (
        ctypes.c_void_p,
        ctypes.c_uint8,
        ctypes.c_uint16,
        ctypes.c_uint32,
        ctypes.c_size_t,
    )
    double, flag, text = ctypes.c_double, ctypes.c_bool, ctypes.c_char_p
    signatures = {
        "create": (here, (text, u32, flag, text, size)),
        "destroy": (None, (here,)),
        "set": (flag, (here, u8, double)),
        "receive": (None, (here, text, size)),
        "step": (size, (here, u32, u16, u16, u16, ctypes.POINTER(_Outputs))),
        "control": (size, (here, u32, double, double, flag, ctypes.POINTER(_Openings))),
        "take_output": (size, (here, ctypes.c_char_p, size)),
        "mode": (u8, (here,)),
        "faults": (u16, (here,)),
        "number": (u16, (here,)),
        "setting": (double, (here, u8)),
        "image_size": (size, ()),
        "unsaved": (flag, (here, ctypes.c_char_p)),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, f"phlosar_{name}")
        function.restype = result
        function.argtypes = arguments
    return library


class CompiledFirmware:
    """One board that runs the real core, from power-up on: as `firmware.Firmware`, and told the same.

    `directly` goes past converter and drivers: pressures in, openings out, as the emulated firmware counts.
    ValueError for settings that the real firmware does not let anyone change, or not so far.
    """

    def __init__(
        self,
        settings: FirmwareSettings | None = None,
        boot_id: int = 1,
        *,
        real: Literal["float", "double"] = "float",
        directly: bool = False,
        stored: bytes = b"",
    ) -> None:
        self.boot_id = boot_id & 0xFFFFFFFF
        self.supply_share = 1.0
        """Of the sensors' 5 V; what the board measures of it."""
        self._start = settings or FirmwareSettings()
        _check(self._start)
        self._library = load(real)
        self._directly = directly
        self._stored = stored
        self._build = (self._start.build or _BUILD).encode("ascii")
        self._outputs = _Outputs()
        self._openings = _Openings()
        self._image = ctypes.create_string_buffer(self._library.phlosar_image_size())
        self._buffer = ctypes.create_string_buffer(_OUTPUT_BYTES)
        self._firmware: int | None = None
        self._power_up(False)

    def __del__(self) -> None:
        if getattr(self, "_firmware", None) is not None:
            self._library.phlosar_destroy(self._firmware)

    @property
    def settings(self) -> FirmwareSettings:
        """As they are now: a host may have changed them."""
        settings = self._start
        for number, row in enumerate(SETTING_ROWS):
            value = self._library.phlosar_setting(self._firmware, number)
            # What did not change keeps its every digit: the chip counts in single precision.
            if not math.isclose(value, value_of(settings, row.name), rel_tol=1e-6, abs_tol=1e-9):
                settings = with_value(settings, row, value) or settings
        return settings

    @property
    def mode(self) -> Mode:
        return Mode(self._library.phlosar_mode(self._firmware))

    @property
    def faults(self) -> Fault:
        """The latched ones."""
        return Fault(self._library.phlosar_faults(self._firmware))

    @property
    def number(self) -> int:
        """Of the last setpoint or vent accepted; 0 before the first."""
        return int(self._library.phlosar_number(self._firmware))

    def reset(self, *, watchdog: bool = False) -> None:
        """A power cycle, or a watchdog's reset: everything but the kept settings is forgotten."""
        self.boot_id = (self.boot_id + 1) & 0xFFFFFFFF
        self._keep_settings()
        self._library.phlosar_destroy(self._firmware)
        self._power_up(watchdog)

    def receive(self, data: bytes) -> None:
        """Bytes from the host. Acted upon at once, as of the last step's time."""
        self._library.phlosar_receive(self._firmware, data, len(data))

    def take_output(self) -> bytes:
        """What is to be sent to the host, once."""
        count = self._library.phlosar_take_output(self._firmware, self._buffer, _OUTPUT_BYTES)
        return ctypes.string_at(self._buffer, count)

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Drive:
        """What the valves are told from now on, given what the sensors say."""
        if self._directly:
            told = self._openings
            self._library.phlosar_control(
                self._firmware, now_us & 0xFFFFFFFF, cv_kPa, reservoir_kPa, True, told
            )
            return Drive(told.evp, told.dvp, told.solenoid)
        supply = self.supply_share * _SUPPLY_COUNTS
        outputs = self._outputs
        self._library.phlosar_step(
            self._firmware,
            now_us & 0xFFFFFFFF,
            _counts(cv_kPa, CV_SENSOR_SPAN_kPa, supply),
            _counts(reservoir_kPa, RESERVOIR_SENSOR_SPAN_kPa, supply),
            min(_FULL_SCALE, round(supply)),
            outputs,
        )
        return Drive(outputs.evp_duty / self._full_evp, outputs.dvp_duty / self._full_dvp, outputs.solenoid)

    def _power_up(self, watchdog: bool) -> None:
        library = self._library
        self._firmware = library.phlosar_create(
            self._build, self.boot_id, watchdog, self._stored, len(self._stored)
        )
        if not self._firmware:
            raise MemoryError
        if not self._stored:
            for number, row in enumerate(SETTING_ROWS):
                if not library.phlosar_set(self._firmware, number, value_of(self._start, row.name)):
                    raise ValueError(
                        f"the firmware does not take {row.name} {value_of(self._start, row.name)}"
                    )
        # What the valves are wired for: a duty that the host sets later changes their currents.
        self._full_evp = math.floor(self._start.evp_full_duty * _FULL_SCALE + 0.5)
        self._full_dvp = math.floor(self._start.dvp_full_duty * _FULL_SCALE + 0.5)

    def _keep_settings(self) -> None:
        if self._library.phlosar_unsaved(self._firmware, self._image):
            self._stored = self._image.raw


def _check(settings: FirmwareSettings) -> None:
    kept = {row.name for row in SETTING_ROWS}
    fixed = {"sensor_beyond_span": (settings.sensor_beyond_span, SENSOR_BEYOND_SPAN)} | {
        name: (getattr(settings.regulator, name), standard)
        for name, standard in RegulatorSettings()._asdict().items()
        if name not in kept
    }
    for name, (wanted, standard) in fixed.items():
        if wanted != standard:
            raise ValueError(f"{name} is compiled into the firmware as {standard} and cannot be changed")


def _counts(kPa: float, span_kPa: float, supply: float) -> int:
    """What the board's converter makes of a ratiometric sensor: 10 … 90 % of its supply over the span."""
    if not math.isfinite(kPa):
        return 0 if not kPa > 0.0 else _FULL_SCALE
    counts = round((0.1 + 0.8 * kPa / span_kPa) * supply)
    return min(_FULL_SCALE, max(0, counts))

"""Loads the firmware's C++ core as a shared library.

Prebuilt libraries for the usual Linux computers need no compiler. Each has a digest of its sources. If the
sources have changed, or on another computer, the library is compiled into the user's cache. `python -m
flying_vines.simulation.phlosar.core_library` renews the prebuilt ones with the compiler of the package
`ziglang`, of the extra `firmware`.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from flying_vines.simulation.phlosar import FirmwareBuildError

SOURCES = Path(__file__).parents[3] / "firmware_link" / "firmware"
PREBUILT = SOURCES / "host" / "prebuilt"
WHAT_TO_INSTALL = "a C++ compiler: sudo apt install g++"
TARGETS = ("x86_64-linux-gnu", "aarch64-linux-gnu", "arm-linux-gnueabihf")
"""The targets of the prebuilt libraries."""
_OLDEST_GLIBC = "2.17"
_FLAGS = (
    "-std=c++17", "-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-fno-exceptions", "-fno-rtti",
    "-ffp-contract=off",
)  # fmt: skip
_ADDRESS, _U8, _U16, _U32, _SIZE = (
    ctypes.c_void_p, ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_size_t,
)  # fmt: skip
_FLOAT, _DOUBLE, _FLAG, _TEXT = ctypes.c_float, ctypes.c_double, ctypes.c_bool, ctypes.c_char_p


class Outputs(ctypes.Structure):
    """Duty cycles, 0 … 65535."""

    _fields_ = (("evp_duty", _U16), ("dvp_duty", _U16), ("solenoid", _FLAG))


class Openings(ctypes.Structure):
    _fields_ = (("evp", _FLOAT), ("dvp", _FLOAT), ("solenoid", _FLAG))


class Row(ctypes.Structure):
    """A setting of the firmware."""

    _fields_ = (("name", _TEXT), ("standard", _FLOAT), ("least", _FLOAT), ("most", _FLOAT))


_SIGNATURES = {
    "phlosar_sources": (_TEXT, ()),
    "phlosar_size": (_SIZE, ()),
    "phlosar_start": (None, (_ADDRESS, _TEXT, _U32, _FLAG, _TEXT, _SIZE)),
    "phlosar_set": (_FLAG, (_ADDRESS, _U8, _FLOAT)),
    "phlosar_receive": (None, (_ADDRESS, _TEXT, _SIZE)),
    "phlosar_step": (None, (_ADDRESS, _U32, _U16, _U16, _U16, ctypes.POINTER(Outputs))),
    "phlosar_control": (None, (_ADDRESS, _U32, _FLOAT, _FLOAT, _FLAG, ctypes.POINTER(Openings))),
    "phlosar_take_output": (_SIZE, (_ADDRESS, _TEXT, _SIZE)),
    "phlosar_mode": (_U8, (_ADDRESS,)),
    "phlosar_faults": (_U16, (_ADDRESS,)),
    "phlosar_number": (_U16, (_ADDRESS,)),
    "phlosar_setting": (_FLOAT, (_ADDRESS, _U8)),
    "phlosar_setting_row": (ctypes.POINTER(Row), (_U8,)),
    "phlosar_image_size": (_SIZE, ()),
    "phlosar_image": (None, (_ADDRESS, _TEXT)),
    "phlosar_unsaved": (_FLAG, (_ADDRESS, _TEXT)),
    "phlosar_tuning_count": (_SIZE, ()),
    "phlosar_tuning_name": (_TEXT, (_SIZE,)),
    "phlosar_standard_tuning": (None, (_ADDRESS,)),
    "phlosar_regulator_size": (_SIZE, ()),
    "phlosar_regulator_start": (None, (_ADDRESS, _ADDRESS)),
    "phlosar_regulator_begin": (None, (_ADDRESS, _DOUBLE)),
    "phlosar_regulator_step": (None, (_ADDRESS, _DOUBLE, _DOUBLE, _DOUBLE, _DOUBLE, _ADDRESS)),
}


@cache
def load() -> ctypes.CDLL:
    """The library. Raises `FirmwareBuildError` if none fits this computer and none can be built."""
    return _prebuilt() or opened(build())


def opened(path: Path) -> ctypes.CDLL:
    """Load a library. Raises `FirmwareBuildError` if this computer cannot load the file."""
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise FirmwareBuildError(f"the firmware cannot be loaded here: {error}") from None
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments
    return library


def _prebuilt() -> ctypes.CDLL | None:
    """The prebuilt library for this computer; None if there is none, or if its sources have changed."""
    for target in TARGETS:
        # A library for another processor does not load.
        with contextlib.suppress(FirmwareBuildError):
            library = opened(prebuilt(target))
            return library if library.phlosar_sources() == sources_digest().encode() else None
    return None


def prebuilt(target: str) -> Path:
    return PREBUILT / f"phlosar-{target}.so"


def compiler() -> str | None:
    """The C++ compiler of this computer ($CXX first), or None."""
    for name in (os.environ.get("CXX"), "c++", "g++", "clang++"):
        if name and (path := shutil.which(name)):
            return path
    return None


def build() -> Path:
    """The library from the cache; built if it is missing. Raises `FirmwareBuildError`."""
    command = compiler()
    if command is None:
        raise FirmwareBuildError(f"the firmware cannot be built here without {WHAT_TO_INSTALL}")
    return built((command, *_flags()), library_files(), "phlosar.so")


def core_files() -> list[Path]:
    """The portable core's sources and headers."""
    core = SOURCES / "phlosar" / "src" / "core"
    return sorted([*core.glob("*.h"), *core.glob("*.cpp")])


def library_files() -> list[Path]:
    return [*core_files(), *sorted((SOURCES / "host").glob("[lr]*.cpp"))]


def sources_digest() -> str:
    digest = hashlib.sha256()
    for file in library_files():
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _flags() -> tuple[str, ...]:
    return (*_FLAGS, f'-DPHLOSAR_SOURCES="{sources_digest()}"')


def built(command: Sequence[str], files: Sequence[Path], name: str) -> Path:
    """The file in the cache that the command builds from these sources and headers; built if it is missing.

    Its name contains a digest of command and sources. Raises `FirmwareBuildError` if it cannot be built or
    stored.
    """
    made_of = hashlib.sha256("\0".join(command).encode())
    for file in files:
        made_of.update(file.read_bytes())
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "flying-vines"
    path = folder / f"{Path(name).stem}-{made_of.hexdigest()[:16]}{Path(name).suffix}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            compile_to(path, command, files)
    except OSError as error:
        raise FirmwareBuildError(f"the firmware cannot be stored in {folder}: {error.strerror}") from None
    return path


def compile_to(path: Path, command: Sequence[str], files: Sequence[Path]) -> None:
    sources = [str(file) for file in files if file.suffix == ".cpp"]
    # Build under a temporary name, because two processes may build at the same time.
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        fresh = Path(folder) / path.name
        made = subprocess.run(
            [*command, "-o", str(fresh), *sources], capture_output=True, text=True, check=False
        )
        if made.returncode != 0:
            raise FirmwareBuildError(f"{command[0]} cannot build the firmware: {made.stderr.strip()}")
        fresh.replace(path)


def prebuild(target: str, path: Path) -> None:
    """Build the library for a target with the compiler of the package `ziglang`."""
    zig = (sys.executable, "-m", "ziglang", "c++", "-target", f"{target}.{_OLDEST_GLIBC}")
    compile_to(path, (*zig, "-nostdlib++", "-s", *_flags()), library_files())


if __name__ == "__main__":
    for target in TARGETS:
        prebuild(target, prebuilt(target))

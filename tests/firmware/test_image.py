"""The complete image for the chip: that it is one, that it fits, and that its stack has a bound."""

from __future__ import annotations

import configparser
import importlib.util
import json
import re
import struct
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from needed import ARM_TOOLS, host_compiler, need

from .native import FIRMWARE, STACK_TOOL, STRICT

SKETCH = FIRMWARE / "phlosar"
GUIDE = Path(__file__).parents[2] / "docs" / "firmware.md"
WIRING = GUIDE.with_name("wiring.md")
STUB = Path(__file__).with_name("arduino_stub")
PINS = SKETCH / "src" / "board" / "pins.h"
SETTINGS_FLASH = 62 * 1024
RAM = range(0x1FFFF800, 0x20001800)
CHIP = ("-mcpu=cortex-m0plus", "-mthumb")


@pytest.fixture(scope="module")
def stack() -> ModuleType:
    """The tool as a module."""
    spec = importlib.util.spec_from_file_location("firmware_stack", STACK_TOOL)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def run(*command: str | Path) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def binary(image: Path) -> bytes:
    return image.with_suffix(".bin").read_bytes()


def test_it_fits_with_its_stack(image: Path) -> None:
    needs = json.loads(run(sys.executable, STACK_TOOL, "--json", image))
    assert 8_000 < needs["flash"] < 48 * 1024
    assert 300 < needs["stack"] < 2048
    assert needs["ram"] == needs["static"] + needs["stack"] < 6 * 1024
    assert len(binary(image)) <= needs["flash"] <= len(binary(image)) + 64


def test_the_guide_says_what_it_needs(image: Path) -> None:
    """To a tenth: another release of the compiler need not make the same bytes."""
    needs = json.loads(run(sys.executable, STACK_TOOL, "--json", image))
    told = dict(re.findall(r"^\| (flash|memory) \| ([\d,]+) \|", GUIDE.read_text(), re.MULTILINE))
    assert int(told["flash"].replace(",", "")) == pytest.approx(needs["flash"], rel=0.1)
    assert int(told["memory"].replace(",", "")) == pytest.approx(needs["ram"], rel=0.1)


def test_the_frames_are_those_that_the_compiler_tells(image: Path, stack: ModuleType) -> None:
    """Of every function of ours; of its library's routines the compiler knows nothing."""
    told: dict[str, int] = {}
    for path in image.parent.rglob("*.ci"):
        for title, size in re.findall(
            r'title: "([^"]+)" label: "[^"]*?(\d+) bytes \(static\)"', path.read_text()
        ):
            told[title.rpartition(":")[2]] = int(size)
        assert "dynamic" not in path.read_text()
    program = stack.Image(run("arm-none-eabi-objdump", "-d", "--no-show-raw-insn", image))
    read = {function.name: function.frame for function in program.functions.values()}
    ours = told.keys() & read.keys()
    assert len(ours) > 60
    assert {name: read[name] for name in ours if read[name] < told[name]} == {}
    assert sum(read[name] == told[name] for name in ours) > 0.9 * len(ours)


def test_the_vectors_are_sane(image: Path) -> None:
    stack_top, *handlers = struct.unpack_from("<48I", binary(image))
    assert stack_top in RAM and stack_top % 8 == 0
    flash = range(0x410, len(binary(image)))
    assert all(handler & 1 and handler in flash for handler in handlers)
    # Reset and USB have handlers of their own; all else is the one that resets the chip.
    assert len(set(handlers)) == 3
    assert handlers.count(handlers[0]) == handlers.count(handlers[16 - 1 + 24]) == 1


def test_the_flash_configuration_does_not_lock_the_chip(image: Path) -> None:
    configuration = binary(image)[0x400:0x410]
    assert configuration[:12] == b"\xff" * 12  # no back door's key, nothing protected
    security, options = configuration[12], configuration[13]
    assert security & 0b11 == 0b10, "the chip would be secured"
    assert security >> 4 & 0b11 != 0b10, "and the bootloader could not erase it"
    assert options & 0b0010_0001_0001 & 0b1_0001 == 0b1_0001, "it would start with slow clocks"
    assert options & 0b100 == 0, "a floating pin could raise the NMI"


def test_nothing_of_a_heap_or_of_exceptions_is_in_it(image: Path) -> None:
    names = {line.split()[-1] for line in run("arm-none-eabi-nm", image).splitlines()}
    forbidden = re.compile(
        r"malloc|calloc|realloc|free\b|_sbrk|__cxa_|_Unwind|__gxx|_Zn[aw]|_Zd[al]|printf|abort|exit|__dso_handle"
    )
    assert {name for name in names if forbidden.search(name)} == set()
    assert {"reset_handler", "usb_handler", "panic_handler"} <= names


def test_hex_and_binary_say_the_same(image: Path) -> None:
    memory: dict[int, int] = {}
    base = 0
    for line in image.with_suffix(".hex").read_text().splitlines():
        record = bytes.fromhex(line.removeprefix(":"))
        assert sum(record) & 0xFF == 0
        size, address, kind = record[0], int.from_bytes(record[1:3], "big"), record[3]
        if kind == 0:
            memory |= {base + address + i: byte for i, byte in enumerate(record[4 : 4 + size])}
        elif kind in (2, 4):
            base = int.from_bytes(record[4:6], "big") << (4 if kind == 2 else 16)
    whole = binary(image)
    assert all(whole[address] == byte for address, byte in memory.items())
    assert max(memory) == len(whole) - 1 < SETTINGS_FLASH


@pytest.mark.parametrize(
    "extra, said",
    [
        ("char more[4096]; ", "RAM"),
        ("const char more[49152] = {1};", "FLASH"),
    ],
)
def test_what_does_not_fit_is_not_linked(image: Path, tmp_path: Path, extra: str, said: str) -> None:
    source = tmp_path / "extra.c"
    source.write_text(extra)
    objects = sorted(str(path) for path in image.parent.rglob("*.o"))
    command = ["arm-none-eabi-gcc", *CHIP, "-nostartfiles", "--specs=nano.specs", "-T", "boards/kl26/kl26.ld"]
    command += ["-Wl,--gc-sections,--undefined=more", *objects, str(source), "-o", str(tmp_path / "no.elf")]
    done = subprocess.run(command, cwd=FIRMWARE, capture_output=True, text=True)
    assert done.returncode != 0
    assert f"region `{said}' overflowed" in done.stderr


UNBOUNDED = {
    "recursion": "int f(int n) { return n < 2 ? n : f(n - 1) + f(n - 2); } int main(void) { return f(9); }",
    "recursion, so that the stack has no bound: f → g → f": """
        int g(int);
        __attribute__((noinline)) int f(int n) { return n ? g(n - 1) + 1 : 0; }
        __attribute__((noinline)) int g(int n) { return f(n / 2) + 2; }
        int main(void) { return f(9); }""",
    "through a register": "int (*volatile f)(void); int main(void) { return f() + 1; }",
    "not known before": """
        volatile int n;
        int main(void) { char c[n]; __asm__ volatile("" : : "r"(c) : "memory"); return c[n - 1]; }""",
}


@pytest.mark.parametrize("said", UNBOUNDED)
def test_what_has_no_bound_is_refused(tmp_path: Path, stack: ModuleType, said: str) -> None:
    need("arm-none-eabi-gcc", ARM_TOOLS)
    (tmp_path / "program.c").write_text(UNBOUNDED[said])
    elf = tmp_path / "program.elf"
    flags = (*CHIP, "-O1", "-nostartfiles", "--specs=nano.specs", "-Wl,-emain,-Ttext=0x100")
    run("arm-none-eabi-gcc", *flags, tmp_path / "program.c", "-o", elf)
    address = int(run("arm-none-eabi-nm", elf).split(" T main")[0].split()[-1], 16)
    listing = run("arm-none-eabi-objdump", "-d", "--no-show-raw-insn", elf)
    with pytest.raises(stack.ImageError, match=said):
        stack.Image(listing).chain(address)


def test_a_chain_of_calls_is_added_up(tmp_path: Path, stack: ModuleType) -> None:
    """Of a listing made by hand: the deeper of two calls counts, a branch out of a function is a call."""
    listing = (
        "00000100 <main>:\n 100:\tpush\t{r4-r7, lr}\n 102:\tsub\tsp, #12\n"
        " 104:\tbl\t200 <f>\n 108:\tbl\t300 <g>\n"
        "00000200 <f>:\n 200:\tpush\t{r4, lr}\n 202:\tb.n\t300 <g>\n"
        "00000300 <g>:\n 300:\tpush\t{r0, r1, r2, lr}\n 302:\tbx\tlr\n"
    )
    chain = stack.Image(listing).chain(0x101)
    assert chain.size == (20 + 12) + 8 + 16
    assert chain.names == ("main", "f", "g")


def test_an_image_that_is_none_is_one_line(tmp_path: Path) -> None:
    need("arm-none-eabi-objdump", ARM_TOOLS)
    (tmp_path / "none.elf").write_text("nothing")
    done = subprocess.run([sys.executable, STACK_TOOL, tmp_path / "none.elf"], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1 and "Traceback" not in done.stderr


@pytest.mark.parametrize("standard", ["gnu++14", "gnu++17"])
def test_teensyduino_would_take_the_sketch(standard: str) -> None:
    """With its board layer, by a host's compiler and against declarations only."""
    sources = sorted(path for path in SKETCH.rglob("*.cpp"))
    assert SKETCH / "src" / "board" / "teensyduino.cpp" in sources
    flags = [f"-std={standard}", *STRICT, "-DARDUINO=10819", "-D__MKL26Z64__", "-I", str(STUB)]
    for unit in (*(["-x", "c++", str(path)] for path in sources), ["-x", "c++", str(SKETCH / "phlosar.ino")]):
        # The IDE includes Arduino.h before a sketch.
        command = [host_compiler(), *flags, "-include", str(STUB / "Arduino.h"), "-fsyntax-only", *unit]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


def test_both_board_layers_name_themselves_within_what_a_welcome_holds() -> None:
    for path in (SKETCH / "src" / "board" / "teensyduino.cpp", FIRMWARE / "boards" / "kl26" / "board.cpp"):
        named = re.search(r'kBuild\[\] = PHLOSAR_VERSION "([^"]+)"', path.read_text())
        version = re.search(r'PHLOSAR_VERSION "([^"]+)"', (SKETCH / "src" / "board" / "board.h").read_text())
        assert named is not None and version is not None
        assert len(version[1] + named[1]) <= 16


def test_the_wiring_guide_has_the_pins_that_are_compiled() -> None:
    compiled = re.findall(r"k(Cv|Reservoir|Supply|Evp|Dvp|Solenoid|Light)Pin = (\d+);", PINS.read_text())
    told = dict(
        re.findall(r"^\| (\d+)(?: \(A\d\))? \| PT[^|]+ \| ([^|]+) \|", WIRING.read_text(), re.MULTILINE)
    )
    words = {
        "Cv": "vine's pressure",
        "Reservoir": "reservoir's pressure",
        "Supply": "the sensors' 5 V",
        "Evp": "(EVP)",
        "Dvp": "(DVP)",
        "Solenoid": "solenoid",
        "Light": "light",
    }
    assert len(compiled) == len(words) == len(set(told))
    for name, pin in compiled:
        assert words[name] in told[pin]


def test_platformio_is_told_the_sketch_and_the_board() -> None:
    project = configparser.ConfigParser()
    project.read(FIRMWARE / "platformio.ini")
    assert (FIRMWARE / project["platformio"]["src_dir"] / "phlosar.ino").is_file()
    assert project["env:teensylc"]["board"] == "teensylc"
    assert project["env:teensylc"]["framework"] == "arduino"

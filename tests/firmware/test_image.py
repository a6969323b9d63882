"""The sketch as it is flashed, built for each board with the maker's core: size, stack and layout."""

from __future__ import annotations

import configparser
import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from required_programs import ARM_TOOLS, host_compiler, need

from flying_vines.install import files

from .conftest import BOARDS
from .native import FIRMWARE, STACK_TOOL, STRICT

pytestmark = pytest.mark.long

SKETCH = FIRMWARE / "phlosar"
GUIDE = Path(__file__).parents[2] / "docs" / "firmware.md"
WIRING = GUIDE.with_name("wiring.md")
STUB = Path(__file__).with_name("arduino_stub")
PINS = SKETCH / "src" / "board" / "pins.h"
CHIP = ("-mcpu=cortex-m0plus", "-mthumb")
FLASH_ON_A_TEENSY_4 = 0x60000000


@pytest.fixture(scope="module")
def stack() -> ModuleType:
    """The tool stack.py as a module."""
    spec = importlib.util.spec_from_file_location("firmware_stack", STACK_TOOL)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def run(*command: str | Path) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def elf(images: Path, board: str) -> Path:
    return images / board / "phlosar.elf"


@pytest.fixture(scope="module")
def needs(images: Path) -> dict[str, dict[str, int]]:
    told = run(sys.executable, STACK_TOOL, "--json", *(elf(images, board) for board in BOARDS))
    found: dict[str, dict[str, int]] = json.loads(told)
    return found


def function(images: Path, board: str, name: str) -> tuple[int, str]:
    """Address and instructions of a function."""
    listing = run("arm-none-eabi-objdump", "-d", "-C", "--no-show-raw-insn", elf(images, board))
    found = re.search(rf"^([0-9a-f]+) <{re.escape(name)}>:\n(.+?)\n\n", listing, re.MULTILINE | re.DOTALL)
    assert found is not None, name
    return int(found[1], 16), found[2]


@pytest.mark.parametrize("board", BOARDS)
def test_it_is_built_for_the_board_and_fits(
    images: Path, needs: dict[str, dict[str, int]], board: str
) -> None:
    """Our own files have no warning; the linker script is the maker's."""
    assert 15_000 < needs[board]["flash"] < 48 * 1024
    assert 300 < needs[board]["stack"] < needs[board]["room"] / 2
    assert (images / board / "phlosar.hex").read_text().startswith(":")


def test_the_guide_lists_the_requirements(needs: dict[str, dict[str, int]]) -> None:
    """Within a tenth, because compiler releases differ."""
    rows = re.findall(
        r"^\| Teensy (4\.0|4\.1|LC) \| ([\d,]+) \| ([\d,]+) \| ([\d,]+) \| ([\d,]+) \|",
        GUIDE.read_text(),
        re.M,
    )
    assert len(rows) == len(BOARDS)
    for name, *cells in rows:
        board = f"teensy{name.replace('.', '').lower()}"
        told = [int(cell.replace(",", "")) for cell in cells]
        right = [needs[board][key] for key in ("flash", "static", "stack", "room")]
        assert told == pytest.approx(right, rel=0.1), name


@pytest.mark.parametrize("board", BOARDS)
def test_the_frames_are_those_that_the_compiler_reports(images: Path, stack: ModuleType, board: str) -> None:
    """This holds for our own functions."""
    told: dict[str, int] = {}
    for path in (images / board / "phlosar").rglob("*.ci"):
        for title, size in re.findall(
            r'title: "([^"]+)" label: "[^"]*?(\d+) bytes \(static\)"', path.read_text()
        ):
            told[title.rpartition(":")[2]] = int(size)
        assert "dynamic" not in path.read_text()
    program = stack.Image(run("arm-none-eabi-objdump", "-d", "--no-show-raw-insn", elf(images, board)))
    read = {function.name: function.frame for function in program.functions.values()}
    ours = told.keys() & read.keys()
    assert len(ours) > 40
    assert {name: read[name] for name in ours if read[name] < told[name]} == {}
    assert sum(read[name] == told[name] for name in ours) > 0.9 * len(ours)


@pytest.mark.parametrize("board", BOARDS)
def test_our_files_use_no_heap_and_no_exceptions(images: Path, board: str) -> None:
    """The maker's core registers destructors of its own timers before `setup`."""
    ours = sorted((images / board / "phlosar").rglob("*.o"))
    assert len(ours) >= 14
    listing = run("arm-none-eabi-nm", "--undefined-only", *ours)
    names = {line.split()[-1] for line in listing.splitlines() if line.strip().startswith("U ")}
    forbidden = re.compile(r"malloc|calloc|realloc|^_?free|^_Zn[aw]|^_Zd[al]|atexit|printf|__cxa_|_Unwind")
    assert {name for name in names if forbidden.search(name)} == set()


@pytest.mark.parametrize("board", BOARDS)
def test_nothing_runs_while_a_conversion_is_awaited(images: Path, board: str) -> None:
    """Our `yield` replaces the maker's and is empty."""
    assert function(images, board, "yield")[1].split()[1:3] == ["bx", "lr"]


@pytest.mark.parametrize("board", ["teensy40", "teensy41"])
def test_code_that_runs_before_the_ram_is_set_up_is_in_flash(images: Path, board: str) -> None:
    address, instructions = function(images, board, "startup_early_hook")
    assert address > FLASH_ON_A_TEENSY_4
    assert re.search(r"\tblx?\t", instructions) is None


@pytest.mark.parametrize("board", ["teensy40", "teensy41"])
def test_no_product_and_sum_are_one_instruction(images: Path, board: str) -> None:
    """A fused instruction rounds once, so the golden runs would differ between boards."""
    listing = run("arm-none-eabi-objdump", "-d", "--no-show-raw-insn", elf(images, board))
    assert re.search(r"\tvfn?m[as]", listing) is None


def test_the_makers_core_has_the_ids_that_the_udev_rule_looks_for(cores: Path) -> None:
    for core in ("teensy3", "teensy4"):
        serial = (cores / core / "usb_desc.h").read_text().partition("defined(USB_SERIAL)")[2]
        ids = [re.search(rf"{name}\s+(0x\w+)", serial) for name in ("VENDOR_ID", "PRODUCT_ID")]
        vendor, product = (int(found[1], 16) for found in ids if found)
        assert (vendor, product) == (files.TEENSY.vendor_id, files.TEENSY.product_id)


UNBOUNDED = {
    "recursion": "int f(int n) { return n < 2 ? n : f(n - 1) + f(n - 2); } int main(void) { return f(9); }",
    "recursion, so that the stack has no bound: f → g → f": """
        int g(int);
        __attribute__((noinline)) int f(int n) { return n ? g(n - 1) + 1 : 0; }
        __attribute__((noinline)) int g(int n) { return f(n / 2) + 2; }
        int main(void) { return f(9); }""",
    "through a register": "int (*volatile f)(void); int main(void) { return f() + 1; }",
    "has no fixed size": """
        volatile int n;
        int main(void) { char c[n]; __asm__ volatile("" : : "r"(c) : "memory"); return c[n - 1]; }""",
}


@pytest.mark.parametrize("said", UNBOUNDED)
def test_code_without_a_stack_bound_is_refused(tmp_path: Path, stack: ModuleType, said: str) -> None:
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
    """A listing made by hand: the deeper of two calls counts, and a branch out of a function is a call."""
    listing = (
        "00000100 <main>:\n 100:\tpush\t{r4-r7, lr}\n 102:\tsub\tsp, #12\n"
        " 104:\tbl\t200 <f>\n 108:\tbl\t300 <g>\n"
        "00000200 <f>:\n 200:\tpush\t{r4, lr}\n 202:\tb.n\t300 <g>\n"
        "00000300 <g>:\n 300:\tpush\t{r0, r1, r2, lr}\n 302:\tbx\tlr\n"
    )
    chain = stack.Image(listing).chain(0x101)
    assert chain.size == (20 + 12) + 8 + 16
    assert chain.names == ("main", "f", "g")


def test_an_invalid_image_gives_one_line(tmp_path: Path) -> None:
    need("arm-none-eabi-objdump", ARM_TOOLS)
    (tmp_path / "none.elf").write_text("nothing")
    done = subprocess.run([sys.executable, STACK_TOOL, tmp_path / "none.elf"], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1 and "Traceback" not in done.stderr


@pytest.mark.parametrize("define", ["-DARDUINO_TEENSY36", "-DESP32", "-DARDUINO_ARCH_RP2040"])
def test_another_board_is_refused_with_the_names_of_those_it_knows(define: str) -> None:
    source = SKETCH / "src" / "board" / "teensyduino.cpp"
    command = [host_compiler(), "-std=gnu++17", "-DARDUINO=10819", define, "-I", str(STUB), "-fsyntax-only"]
    done = subprocess.run([*command, str(source)], capture_output=True, text=True)
    assert done.returncode != 0
    assert "phlosar supports Teensy 4.0, Teensy 4.1 and Teensy LC" in done.stderr


@pytest.mark.parametrize("standard", ["gnu++14", "gnu++17"])
@pytest.mark.parametrize("define", ["-DARDUINO_TEENSY40", "-DARDUINO_TEENSY41", "-D__MKL26Z64__"])
def test_the_sketch_compiles_without_the_makers_core(standard: str, define: str) -> None:
    """It compiles against declarations if the maker's core is not installed."""
    sources = sorted(path for path in SKETCH.rglob("*.cpp"))
    flags = [f"-std={standard}", *STRICT, "-DARDUINO=10819", define, "-I", str(STUB)]
    sketches = (SKETCH / "phlosar.ino", *(SKETCH / "examples").rglob("*.ino"))
    units = [*([str(path)] for path in sources), *(["-x", "c++", str(path)] for path in sketches)]
    for unit in units:
        # The IDE includes Arduino.h before a sketch, and a library's src folder is on its path.
        command = [host_compiler(), *flags, "-I", str(SKETCH / "src"), "-include", str(STUB / "Arduino.h")]
        done = subprocess.run([*command, "-fsyntax-only", *unit], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


def test_the_folder_is_a_sketch_and_a_library() -> None:
    """As the Arduino library specification says: properties, src, and examples in folders of their names."""
    properties = dict(
        line.split("=", 1) for line in (SKETCH / "library.properties").read_text().splitlines() if line
    )
    wanted = {"name", "version", "author", "maintainer", "sentence", "paragraph", "category", "url"}
    assert wanted | {"architectures"} <= properties.keys()
    assert (SKETCH / "src" / properties["includes"]).is_file()
    version = re.search(r'PHLOSAR_VERSION "([^"]+)"', (SKETCH / "src" / "board" / "board.h").read_text())
    assert version is not None and properties["version"] == f"{version[1]}.0"
    assert (SKETCH / f"{SKETCH.name}.ino").is_file()
    for example in (SKETCH / "examples").iterdir():
        assert (example / f"{example.name}.ino").is_file()


def test_every_board_names_itself_within_what_a_welcome_holds() -> None:
    named = re.findall(
        r'kBuild\[\] = PHLOSAR_VERSION "([^"]+)"',
        "".join(path.read_text() for path in (SKETCH / "src" / "board").glob("*.cpp")),
    )
    assert {name.strip() for name in named} == set(BOARDS)
    assert all(len("1.1" + name) <= 16 for name in named)


def test_the_wiring_guide_has_the_pins_that_are_compiled() -> None:
    compiled = re.findall(r"k(Cv|Reservoir|Supply|Evp|Dvp|Solenoid|Light)Pin = (\d+);", PINS.read_text())
    told = dict(re.findall(r"^\| (\d+)(?: \(A\d\))? \| ([^|]+) \|", WIRING.read_text(), re.MULTILINE))
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


def test_platformio_gets_the_sketch_and_the_boards() -> None:
    project = configparser.ConfigParser()
    project.read(FIRMWARE / "platformio.ini")
    assert (FIRMWARE / project["platformio"]["src_dir"] / "phlosar.ino").is_file()
    assert {project[f"env:{board}"]["board"] for board in BOARDS} == set(BOARDS)
    assert project["env"]["framework"] == "arduino"

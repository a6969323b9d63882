"""The core's library on this computer: its build, and the conversions between counts and pressures."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from required_programs import needs_compiler

from firmware_link.protocol import (
    PROTOCOL_VERSION,
    Codec,
    Fault,
    Hello,
    Mode,
    Setpoint,
    SetSetting,
    Telemetry,
    Welcome,
)
from flying_vines.simulation.phlosar import FirmwareBuildError, core_library
from flying_vines.simulation.phlosar.core_library import TARGETS
from flying_vines.simulation.phlosar.firmware import SAFE, Firmware, Regulator, setting_rows

from .golden_run import Part, difference, on_host, read

DOCS = Path(__file__).parents[2] / "docs"


def telemetry(firmware: Firmware, codec: Codec) -> Telemetry:
    """The latest telemetry."""
    return [m for m in codec.decode(firmware.take_output()) if isinstance(m, Telemetry)][-1]


def run(firmware: Firmware, from_ms: int, steps: int, cv_kPa: float, reservoir_kPa: float) -> None:
    for ms in range(from_ms, from_ms + steps):
        drive = firmware.step(1000 * ms, cv_kPa, reservoir_kPa)
        if firmware.mode is not Mode.REGULATE:
            assert drive == SAFE


def test_pressures_come_through_converter_and_divider() -> None:
    for cv_kPa, reservoir_kPa in ((0.0, 0.0), (20.7, 690.0), (-10.0, 55.0), (200.0, 1500.0)):
        firmware, codec = Firmware(), Codec()
        firmware.step(0, cv_kPa, reservoir_kPa)
        told = telemetry(firmware, codec)
        # Half a count of 65535, and single precision.
        assert told.cv_kPa == pytest.approx(cv_kPa, abs=206.84 / 0.8 / 59578 * 0.51)
        assert told.reservoir_kPa == pytest.approx(reservoir_kPa, abs=1500 / 0.8 / 59578 * 0.51)


def test_a_weak_supply_does_not_change_what_is_read_until_it_is_too_weak() -> None:
    firmware, codec = Firmware(), Codec()
    firmware.supply_share = 0.92
    run(firmware, 0, 20, 12.0, 600.0)
    assert telemetry(firmware, codec).cv_kPa == pytest.approx(12.0, abs=0.005)
    assert not firmware.faults
    firmware.supply_share = 0.89
    run(firmware, 20, 2, 12.0, 600.0)
    assert not firmware.faults
    run(firmware, 22, 1, 12.0, 600.0)
    assert firmware.faults == Fault.SUPPLY | Fault.CV_SENSOR | Fault.RESERVOIR_SENSOR
    firmware.supply_share = 1.2
    run(firmware, 23, 10, 12.0, 600.0)
    assert Fault.SUPPLY in firmware.faults


@pytest.mark.parametrize("spoil", [0, 3, 20, -1])
def test_damaged_settings_are_not_used_and_are_reported(spoil: int) -> None:
    firmware, codec = Firmware(), Codec()
    firmware.step(0, 0.0, 690.0)
    firmware.receive(codec.encode(Hello(PROTOCOL_VERSION, 1)) + codec.encode(SetSetting(0, 20.0)))
    firmware.reset()
    kept = bytearray(firmware._stored)
    assert Firmware(stored=bytes(kept)).settings["cv_limit_kPa"] == 20.0
    kept[spoil] ^= 0x10
    damaged = Firmware(stored=bytes(kept))
    assert damaged.faults == Fault.SETTINGS
    assert damaged.settings == Firmware().settings


def test_a_memory_that_was_never_written_is_no_fault() -> None:
    assert Firmware(stored=b"\xff" * 128).faults == Fault.NONE
    assert Firmware(stored=b"\x00" * 128).faults == Fault.SETTINGS


def test_the_stand_in_has_the_version_of_the_sketch() -> None:
    header = core_library.SOURCES / "phlosar" / "src" / "board" / "board.h"
    (version,) = re.findall(r'PHLOSAR_VERSION "(.+)"', header.read_text())
    firmware, codec = Firmware(), Codec()
    firmware.step(0, 0.0, 690.0)
    firmware.receive(codec.encode(Hello(PROTOCOL_VERSION, 1)))
    answers = codec.decode(firmware.take_output())
    assert [m.firmware_build for m in answers if isinstance(m, Welcome)] == [f"{version} host"]


def test_settings_reach_the_core() -> None:
    wanted = {"cv_limit_kPa": 25.0, "dead_man_ms": 120.0, "on_off_error_kPa": 1.0}
    assert Firmware(wanted).settings == Firmware().settings | wanted
    with pytest.raises(ValueError, match="does not accept dead_man_ms 301"):
        Firmware({"dead_man_ms": 301})
    with pytest.raises(ValueError, match="no setting tolerated_kPa"):
        Firmware({"tolerated_kPa": 0.5})
    with pytest.raises(ValueError, match="regulator has no tuning value cv_limit_kPa"):
        Regulator({"cv_limit_kPa": 0.5})


def test_openings_are_of_the_current_that_the_valves_are_wired_for() -> None:
    firmware, codec = Firmware(), Codec()
    firmware.step(0, 0.0, 690.0)
    firmware.receive(codec.encode(Hello(PROTOCOL_VERSION, 1)))
    codec.decode(firmware.take_output())
    firmware.receive(codec.encode(Setpoint(20.0, 200.0, 300, 1)))
    openings = [firmware.step(1000 * ms, 0.0, 690.0).evp for ms in range(1, 250)]
    assert max(openings) == 1.0
    assert telemetry(firmware, codec).evp_opening == 1.0


def test_without_a_compiler_it_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(FirmwareBuildError, match=r"without a C\+\+ compiler: sudo apt install"):
        core_library.build()


@needs_compiler
def test_it_is_built_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = core_library.build()
    made_at = first.stat().st_mtime_ns
    assert core_library.build() == first
    assert first.stat().st_mtime_ns == made_at
    assert [path.name for path in (tmp_path / "flying-vines").iterdir()] == [first.name]


@needs_compiler
def test_a_cache_that_cannot_be_written_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "flying-vines").write_text("in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(FirmwareBuildError, match="cannot be stored in"):
        core_library.build()


@pytest.mark.parametrize("target", TARGETS)
def test_the_prebuilt_libraries_are_of_these_sources(target: str) -> None:
    """If this fails: pip install 'flying-vines[firmware]', and build them as `core_library` says."""
    assert core_library.sources_digest().encode() in core_library.prebuilt(target).read_bytes()


@pytest.mark.parametrize("target", TARGETS)
def test_the_prebuilt_libraries_are_what_these_sources_give(target: str, tmp_path: Path) -> None:
    pytest.importorskip("ziglang")
    core_library.prebuild(target, tmp_path / "phlosar.so")
    assert (tmp_path / "phlosar.so").read_bytes() == core_library.prebuilt(target).read_bytes()


@needs_compiler
@pytest.mark.parametrize("part", read(), ids=lambda part: part.name)
def test_the_library_built_here_repeats_the_golden_run(part: Part) -> None:
    assert difference(part, on_host(part.inputs, core_library.opened(core_library.build()))) == ""


@needs_compiler
def test_changed_sources_are_built_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(core_library, "sources_digest", lambda: "changed")
    assert core_library.load.__wrapped__().phlosar_sources() == b"changed"


@pytest.mark.parametrize("name", setting_rows())
def test_the_docs_list_every_setting(name: str) -> None:
    row = setting_rows()[name]
    table = (DOCS / "serial-protocol.md").read_text().replace("−", "-")
    cells = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in table.splitlines()
        if re.match(rf"\| {row.number} \| {name} \|", line)
    ]
    assert len(cells) == 1
    wanted = (row.standard, row.min, row.max)
    assert [float(cell) for cell in cells[0][2:5]] == pytest.approx(wanted, rel=1e-6)

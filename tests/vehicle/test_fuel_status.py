"""FUEL_STATUS agrees with pymavlink's own generator from the message's definition."""

from __future__ import annotations

import importlib.util
import math
import shutil
import struct
from pathlib import Path
from typing import Any

import pymavlink.dialects.v20 as dialects
import pytest
from pymavlink.generator import mavgen, mavparse

from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mavlink.fuel_status import fuel_status

DEFINITION = """<?xml version="1.0"?>
<mavlink>
  <include>ardupilotmega.xml</include>
  <messages>
    <message id="371" name="FUEL_STATUS">
      <description>Fuel status.</description>
      <field type="uint8_t" name="id" instance="true">Fuel ID.</field>
      <field type="float" name="maximum_fuel">Capacity when full.</field>
      <field type="float" name="consumed_fuel" invalid="NaN">Consumed fuel (measured).</field>
      <field type="float" name="remaining_fuel" invalid="NaN">Remaining fuel until empty (measured).</field>
      <field type="uint8_t" name="percent_remaining" units="%" invalid="UINT8_MAX">Percentage.</field>
      <field type="float" name="flow_rate" invalid="NaN">Positive when emptying.</field>
      <field type="float" name="temperature" units="K" invalid="NaN">Fuel temperature.</field>
      <field type="uint32_t" name="fuel_type">Fuel type.</field>
    </message>
  </messages>
</mavlink>
"""


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A dialect with this message, generated the way everybody else has it."""
    folder = tmp_path_factory.mktemp("dialect")
    for definition in Path(dialects.__path__[0]).glob("*.xml"):
        shutil.copy(definition, folder)
    (folder / "with_fuel.xml").write_text(DEFINITION, encoding="utf-8")
    options = mavgen.Opts(
        str(folder / "with_fuel"), wire_protocol=mavparse.PROTOCOL_2_0, language="Python3", validate=False
    )
    assert mavgen.mavgen(options, [str(folder / "with_fuel.xml")])
    spec = importlib.util.spec_from_file_location("with_fuel", folder / "with_fuel.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_others_read_what_we_write(generated: Any) -> None:
    frame = MavlinkCodec(1, 191).encode(fuel_status(437.5, 500.0, 12.25, 293.0), 1)
    (read,) = generated.MAVLink(None).parse_buffer(frame)
    assert read.get_type() == "FUEL_STATUS"
    assert (read.id, read.maximum_fuel, read.remaining_fuel, read.percent_remaining) == (0, 500.0, 437.5, 88)
    assert (read.flow_rate, read.temperature, read.fuel_type) == (12.25, 293.0, 2)
    assert math.isnan(read.consumed_fuel)


@pytest.mark.parametrize(
    ("reservoir_kPa", "full_kPa", "percent"),
    [
        (437.5, 500.0, 88),
        (0.0, 500.0, 0),
        (500.0, 500.0, 100),
        (612.0, 500.0, 100),
        (-0.3, 500.0, 0),
        (math.nan, 500.0, 255),
    ],
)
def test_byte_for_byte_as_others_write_it(
    generated: Any, reservoir_kPa: float, full_kPa: float, percent: int
) -> None:
    theirs = generated.MAVLink(None, srcSystem=1, srcComponent=191)
    expected = generated.MAVLink_fuel_status_message(
        0, full_kPa, math.nan, reservoir_kPa, percent, 3.5, math.nan, 2
    )
    assert MavlinkCodec(1, 191).encode(fuel_status(reservoir_kPa, full_kPa, 3.5), 1) == expected.pack(theirs)


def test_it_has_the_published_identity() -> None:
    message = fuel_status(437.5, 500.0)
    frame = MavlinkCodec(1, 191).encode(message, 1)
    assert int.from_bytes(frame[7:10], "little") == message.get_msgId() == 371
    assert (type(message).crc_extra, type(message).unpacker.size) == (10, 26)
    assert struct.unpack_from("<f", frame, 10 + 8) == (437.5,)


def test_people_can_read_it() -> None:
    assert str(fuel_status(437.5, 500.0, temperature_K=293.0)) == (
        "FUEL_STATUS {id : 0, maximum_fuel : 500.0, consumed_fuel : nan, remaining_fuel : 437.5, "
        "percent_remaining : 88, flow_rate : nan, temperature : 293.0, fuel_type : 2}"
    )
    assert fuel_status(437.5, 500.0).to_dict()["remaining_fuel"] == 437.5


def test_what_a_fuel_gauge_of_others_says_is_not_for_us() -> None:
    sender, receiver = MavlinkCodec(1, 30), MavlinkCodec(1, 191)
    frame = sender.encode(fuel_status(437.5, 500.0), 1)
    assert receiver.decode(frame + frame) == []

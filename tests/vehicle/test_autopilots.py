"""The RC failsafe of each autopilot, derived from its parameters."""

from __future__ import annotations

import math
import struct

import pytest
from param_value import param_value
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.autopilots import AUTOPILOTS, OTHER, of_heartbeat

ARDUPILOT, PX4 = AUTOPILOTS["ardupilot"], AUTOPILOTS["px4"]


def test_a_heartbeat_names_the_autopilot() -> None:
    assert of_heartbeat(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA) is ARDUPILOT
    assert of_heartbeat(mavlink.MAV_AUTOPILOT_PX4) is PX4
    assert of_heartbeat(mavlink.MAV_AUTOPILOT_GENERIC) is OTHER


@pytest.mark.parametrize(
    ("values", "hides"),
    [
        ({}, ""),
        ({"FS_THR_ENABLE": 1.0, "RC_FS_TIMEOUT": 1.0, "RC_OPTIONS": 32.0}, ""),
        ({"FS_THR_ENABLE": 0.0}, "FS_THR_ENABLE 0"),
        ({"RC_FS_TIMEOUT": 8.0}, "RC_FS_TIMEOUT 8"),
        ({"RC_OPTIONS": 33.0}, "RC_OPTIONS 33"),
        ({"RC_OPTIONS": 4.0}, "RC_OPTIONS 4"),
    ],
)
def test_parameters_with_which_ardupilot_hides_a_loss(values: dict[str, float], hides: str) -> None:
    assert ARDUPILOT.hides_rc_loss(values) == hides


def test_how_long_ardupilot_keeps_an_override() -> None:
    assert ARDUPILOT.override_lasts_s({}) == 3.0
    assert ARDUPILOT.override_lasts_s({"RC_OVERRIDE_TIME": 5.0}) == 5.0
    assert ARDUPILOT.override_lasts_s({"RC_OVERRIDE_TIME": 0.0}) == 0.0
    assert ARDUPILOT.override_lasts_s({"RC_OVERRIDE_TIME": -1.0}) == math.inf
    assert ARDUPILOT.override_lasts_s({"RC_OVERRIDE_TIME": 3.0, "RC_OPTIONS": 2.0}) == 0.0


def test_px4_sends_whole_numbers_as_their_bytes() -> None:
    (as_float,) = struct.unpack("<f", struct.pack("<i", 1))
    value = PX4.parameter_value(param_value("COM_RC_IN_MODE", as_float, mavlink.MAV_PARAM_TYPE_INT32))
    assert PX4.hides_rc_loss({"COM_RC_IN_MODE": value}) == "COM_RC_IN_MODE 1"


def test_px4_shows_a_loss_after_the_configured_delay() -> None:
    assert PX4.rc_loss_shows_within_s({}) == pytest.approx(1.6)
    assert PX4.rc_loss_shows_within_s({"COM_RC_LOSS_T": 0.5}) == pytest.approx(1.6)
    assert PX4.rc_loss_shows_within_s({"COM_RC_LOSS_T": 3.0}) == pytest.approx(4.1)

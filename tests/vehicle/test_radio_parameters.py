"""What the autopilot's parameters say of its RC failsafe: asked for, read, and what follows."""

from __future__ import annotations

import struct

import pytest
from param_value import param_value
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.radio.radio_parameters import MOST_ATTEMPTS, NAMES, RadioParameters


def read(autopilot: str, **values: float) -> RadioParameters:
    parameters = RadioParameters()
    for name, number in values.items():
        assert parameters.handle(autopilot, param_value(name, number))
    return parameters


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_each_is_asked_for_until_it_is_answered_and_then_no_more(autopilot: str) -> None:
    parameters = RadioParameters()
    names = NAMES[autopilot]
    silent, asked = names[-1], []
    for tick in range(5000):
        for request in parameters.requests(tick * 0.02, 1, autopilot):
            name = request.param_id
            assert (request.target_system, request.target_component, request.param_index) == (1, 1, -1)
            asked.append(name)
            if name != silent:
                parameters.handle(autopilot, param_value(name, 1.0))
    assert [asked.count(name) for name in names[:-1]] == [1] * (len(names) - 1)
    assert asked.count(silent) == MOST_ATTEMPTS


def test_they_are_asked_for_again_after_a_reboot_and_before_a_flight() -> None:
    parameters = read("ardupilot", FS_THR_ENABLE=0.0)
    parameters.refresh()
    assert parameters.hides_loss == "FS_THR_ENABLE 0"
    assert parameters.requests(1.0, 1, "ardupilot")
    parameters.forget()
    assert parameters.hides_loss == ""


def test_of_other_autopilots_and_parameters_nothing_is_made() -> None:
    parameters = RadioParameters()
    assert not parameters.requests(0.0, 1, "other")
    assert not parameters.handle("other", param_value("FS_THR_ENABLE", 0.0))
    assert not parameters.handle("ardupilot", param_value("STAT_RUNTIME", 0.0))
    assert not parameters.handle("ardupilot", param_value("FS_THR_ENABLE", float("nan")))
    assert parameters.values == {}


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
def test_what_lets_ardupilot_hide_a_loss(values: dict[str, float], hides: str) -> None:
    assert read("ardupilot", **values).hides_loss == hides


def test_how_long_ardupilot_keeps_an_override() -> None:
    assert RadioParameters().override_lasts_s == 3.0
    assert read("ardupilot", RC_OVERRIDE_TIME=5.0).override_lasts_s == 5.0
    assert read("ardupilot", RC_OVERRIDE_TIME=0.0).override_lasts_s == 0.0
    assert read("ardupilot", RC_OVERRIDE_TIME=-1.0).override_lasts_s == float("inf")
    assert read("ardupilot", RC_OVERRIDE_TIME=3.0, RC_OPTIONS=2.0).override_lasts_s == 0.0


def test_px4_sends_whole_numbers_as_their_bytes() -> None:
    (as_float,) = struct.unpack("<f", struct.pack("<i", 1))
    parameters = RadioParameters()
    parameters.handle("px4", param_value("COM_RC_IN_MODE", as_float, mavlink.MAV_PARAM_TYPE_INT32))
    assert parameters.hides_loss == "COM_RC_IN_MODE 1"


def test_px4_shows_a_loss_as_late_as_it_is_told_to() -> None:
    assert RadioParameters().px4_shows_loss_within_s == pytest.approx(1.6)
    assert read("px4", COM_RC_LOSS_T=0.5).px4_shows_loss_within_s == pytest.approx(1.6)
    assert read("px4", COM_RC_LOSS_T=3.0).px4_shows_loss_within_s == pytest.approx(4.1)

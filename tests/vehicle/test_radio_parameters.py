"""The autopilot's parameters of its RC failsafe: requested, read, and their consequences."""

from __future__ import annotations

import pytest
from param_value import param_value

from flying_vines.vehicle.autopilots import AUTOPILOTS, OTHER
from flying_vines.vehicle.autopilots.autopilot import Autopilot
from flying_vines.vehicle.mission.item import AutopilotKind
from flying_vines.vehicle.radio.rc import MAX_ATTEMPTS, RadioParameters

ARDUPILOT = AUTOPILOTS["ardupilot"]


def read(autopilot: Autopilot, **values: float) -> RadioParameters:
    parameters = RadioParameters(9)
    for name, number in values.items():
        assert parameters.handle(autopilot, param_value(name, number))
    return parameters


@pytest.mark.parametrize("autopilot", AUTOPILOTS.values())
def test_each_parameter_is_requested_until_it_is_answered(autopilot: Autopilot) -> None:
    parameters = RadioParameters(9)
    names = autopilot.rc_parameters
    silent, asked = names[-1], []
    for tick in range(5000):
        for request in parameters.requests(tick * 0.02, 1, autopilot):
            name = request.param_id
            assert (request.target_system, request.target_component, request.param_index) == (1, 1, -1)
            asked.append(name)
            if name != silent:
                parameters.handle(autopilot, param_value(name, 1.0))
    assert [asked.count(name) for name in names[:-1]] == [1] * (len(names) - 1)
    assert asked.count(silent) == MAX_ATTEMPTS


def test_parameters_are_requested_again_after_a_reboot_and_before_a_flight() -> None:
    parameters = read(ARDUPILOT, FS_THR_ENABLE=0.0)
    parameters.refresh()
    assert parameters.values == {"FS_THR_ENABLE": 0.0}
    assert parameters.requests(1.0, 1, ARDUPILOT)
    parameters.forget()
    assert parameters.values == {}


@pytest.mark.parametrize(
    ("kind", "values", "use"),
    [
        ("ardupilot", {"RC9_OPTION": 31.0}, "RC9_OPTION is 31"),
        ("ardupilot", {"RC9_OPTION": 0.0}, ""),
        ("px4", {"RC_MAP_KILL_SW": 9.0}, "RC_MAP_KILL_SW is 9"),
        ("px4", {"RC_MAP_KILL_SW": 8.0, "RC_MAP_RETURN_SW": 0.0}, ""),
    ],
)
def test_another_use_of_the_switchs_channel_is_found(
    kind: AutopilotKind, values: dict[str, float], use: str
) -> None:
    autopilot = AUTOPILOTS[kind]
    assert autopilot.other_use(9, read(autopilot, **values).values) == use


def test_other_autopilots_and_parameters_have_no_effect() -> None:
    parameters = RadioParameters(9)
    assert not parameters.requests(0.0, 1, OTHER)
    assert not parameters.handle(OTHER, param_value("FS_THR_ENABLE", 0.0))
    assert not parameters.handle(ARDUPILOT, param_value("STAT_RUNTIME", 0.0))
    assert not parameters.handle(ARDUPILOT, param_value("FS_THR_ENABLE", float("nan")))
    assert parameters.values == {}

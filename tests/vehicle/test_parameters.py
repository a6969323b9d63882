"""Settings as MAVLink parameters: listed, read, set within configured bounds, or refused with a reason."""

from __future__ import annotations

import itertools
import math
import struct
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from examples import examples
from flying_vines.config import config
from flying_vines.config.config import Config
from flying_vines.vehicle.component.parameter_table import (
    BY_NAME,
    SETTINGS,
    ParameterRefused,
    bounds,
    decimal,
    value_of,
)
from flying_vines.vehicle.component.parameters import LIST_SPACING_S, Changed, Parameters
from flying_vines.vehicle.component.senders import Sender
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.notice import Notice, Severity

US, STATION = (1, 191), (255, 190)
SENDER = Sender(*STATION, is_station=True)
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
DEFAULT = config.default()
TICK_S = 0.02


def configured(**tables: dict[str, Any]) -> Config:
    """The default configuration with other values."""
    return msgspec.structs.replace(
        DEFAULT,
        **{name: msgspec.structs.replace(getattr(DEFAULT, name), **keys) for name, keys in tables.items()},
    )


def sent(message: MavlinkMessage, sender: tuple[int, int] = STATION) -> MavlinkMessage:
    return mavlink.MAVLink(None).parse_char(message.pack(mavlink.MAVLink(None, *sender)))


def setting(
    name: str, value: float, param_type: int = REAL32, target: tuple[int, int] = US
) -> mavlink.MAVLink_param_set_message:
    return mavlink.MAVLink_param_set_message(*target, name.encode(), value, param_type)


class Bench:
    """A parameter set, and the results of each message."""

    def __init__(self, of: Config = DEFAULT, values: dict[str, float] | None = None) -> None:
        self.parameters = Parameters(of, values)
        self.may_change = True
        self.t = 10.0

    def take(self, message: MavlinkMessage) -> tuple[list[MavlinkMessage], list[str], list[Changed]]:
        outputs = self.parameters.handle(self.t, sent(message), US, SENDER, self.may_change)
        values = [sent(output, US) for output in outputs if isinstance(output, mavlink.MAVLink_message)]
        texts = [output.text for output in outputs if isinstance(output, Notice)]
        return values, texts, [output for output in outputs if isinstance(output, Changed)]

    def set(
        self, name: str, value: float, param_type: int = REAL32
    ) -> tuple[float, list[str], list[Changed]]:
        """Set a parameter. Returns the value in the answer, the texts, and the change."""
        (answer,), texts, changes = self.take(setting(name, value, param_type))
        assert (answer.param_type, answer.param_count) == (REAL32, len(SETTINGS))
        assert SETTINGS[answer.param_index].name == answer.param_id == name
        return answer.param_value, texts, changes

    def wait(self, for_s: float) -> list[tuple[float, MavlinkMessage]]:
        listed = []
        for _ in range(round(for_s / TICK_S)):
            listed += [(self.t, sent(message, US)) for message in self.parameters.due(self.t)]
            self.t += TICK_S
        return listed


def f32(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def test_names_and_order_are_as_mavlink_requires() -> None:
    names = [row.name for row in SETTINGS]
    assert len(set(names)) == len(names) == 14
    assert all(name.startswith("VINE_") and len(name) <= 16 and name.isupper() for name in names)
    assert all(row.doc and row.doc.isascii() for row in SETTINGS)


@pytest.mark.parametrize("row", SETTINGS, ids=lambda row: row.name)
def test_each_row_has_a_key_of_the_configuration_and_bounds_around_its_value(row: Any) -> None:
    least, most = bounds(row, DEFAULT)
    assert math.isfinite(least)
    assert math.isfinite(most)
    assert least <= value_of(row, DEFAULT) <= most
    assert least < most


def test_settings_that_must_not_change_in_the_field_are_no_parameters() -> None:
    keys = {(row.table, row.key) for row in SETTINGS}
    for key in ("bench_mode", "armed_at_start"):
        assert ("interlocks", key) not in keys
    assert ("limits", "overpressure_kPa") not in keys
    assert not {table for table, _ in keys} & {"vehicle", "firmware", "pneumatics", "vine", "items", "state"}


# Listing and reading.


@pytest.mark.parametrize("target", [US, (1, 0), (0, 0)])
def test_the_list_comes_once_in_order_and_spaced(target: tuple[int, int]) -> None:
    bench = Bench()
    assert bench.take(mavlink.MAVLink_param_request_list_message(*target)) == ([], [], [])
    listed = bench.wait(5.0)
    assert [message.param_index for _, message in listed] == list(range(len(SETTINGS)))
    for (_, message), row in zip(listed, SETTINGS, strict=True):
        assert message.param_id == row.name
        assert message.param_value == f32(value_of(row, DEFAULT))
        assert (message.param_type, message.param_count) == (REAL32, len(SETTINGS))
    gaps_s = [later - t for (t, _), (later, _) in itertools.pairwise(listed)]
    assert all(LIST_SPACING_S - 1e-6 <= gap_s <= LIST_SPACING_S + 1.01 * TICK_S for gap_s in gaps_s)


def test_a_list_that_is_requested_again_starts_again_and_is_not_sent_twice() -> None:
    bench = Bench()
    bench.take(mavlink.MAVLink_param_request_list_message(*US))
    first = bench.wait(0.55)
    bench.take(mavlink.MAVLink_param_request_list_message(*US))
    then = bench.wait(10.0)
    assert 0 < len(first) < len(SETTINGS)
    assert [message.param_index for _, message in then] == list(range(len(SETTINGS)))


@pytest.mark.parametrize("target", [(1, 1), (2, 191), (2, 0), (1, 190), (0, 191)])
def test_messages_for_others_are_not_answered(target: tuple[int, int]) -> None:
    bench = Bench()
    assert bench.take(mavlink.MAVLink_param_request_list_message(*target)) == ([], [], [])
    assert bench.wait(1.0) == []
    read = mavlink.MAVLink_param_request_read_message(*target, b"VINE_MAX_KPA", -1)
    assert bench.take(read) == ([], [], [])
    assert bench.take(setting("VINE_MAX_KPA", 10.0, target=target)) == ([], [], [])
    assert bench.parameters.config == DEFAULT


def test_a_parameter_is_read_and_set_only_by_messages_addressed_to_us() -> None:
    bench = Bench()
    for target in ((1, 0), (0, 0)):
        read = mavlink.MAVLink_param_request_read_message(*target, b"", 0)
        assert bench.take(read) == ([], [], [])
        assert bench.take(setting("VINE_MAX_KPA", 10.0, target=target)) == ([], [], [])
    assert bench.parameters.config == DEFAULT


def test_read_by_name_and_by_index() -> None:
    bench = Bench()
    for index, row in enumerate(SETTINGS):
        by_name = mavlink.MAVLink_param_request_read_message(*US, row.name.encode(), -1)
        by_index = mavlink.MAVLink_param_request_read_message(*US, b"VINE_SW_CHAN", index)
        for request in (by_name, by_index):
            (answer,), texts, changes = bench.take(request)
            assert (answer.param_id, answer.param_index) == (row.name, index)
            assert answer.param_value == f32(value_of(row, DEFAULT))
            assert not texts
            assert not changes


@pytest.mark.parametrize(
    ("name", "index"),
    [(b"_HASH_CHECK", -1), (b"VINE_NOTHING", -1), (b"", -1), (b"VINE_SW_CHAN", 16), (b"VINE_SW_CHAN", -2)],
)
def test_unknown_parameters_are_not_answered(name: bytes, index: int) -> None:
    bench = Bench()
    assert bench.take(mavlink.MAVLink_param_request_read_message(*US, name, index)) == ([], [], [])
    assert bench.take(setting("_HASH_CHECK", 1.0)) == ([], [], [])


# Setting.


def test_a_value_that_is_set_is_active() -> None:
    bench = Bench()
    answer, texts, (change,) = bench.set("VINE_MAX_KPA", 18.1)
    assert answer == f32(18.1)
    assert change.config.limits.max_kPa == bench.parameters.config.limits.max_kPa == 18.1
    assert (change.t, change.name, change.value) == (10.0, "VINE_MAX_KPA", 18.1)
    assert texts == ["Vine: VINE_MAX_KPA is 18.1, was 20.7"]
    assert bench.parameters.values == {"VINE_MAX_KPA": 18.1}
    assert msgspec.structs.replace(change.config, limits=DEFAULT.limits) == DEFAULT


@pytest.mark.parametrize(
    ("name", "value", "kept"),
    [
        ("VINE_SW_CHAN", 7.0, 7),
        ("VINE_RC_ACTION", 1.0, "hold"),
        ("VINE_SW_DEBOUNCE", 0.2, 0.2),
        ("VINE_MIN_ALT_M", 5.0, 5.0),
        ("VINE_RESERVE_KPA", 60.0, 60.0),
        ("VINE_RATE_HZ", 0.7, 0.7),
    ],
)
def test_values_become_what_the_configuration_has(name: str, value: float, kept: object) -> None:
    bench = Bench()
    bench.set(name, value)
    row = BY_NAME[name]
    now = getattr(getattr(bench.parameters.config, row.table), row.key)
    assert now == kept
    assert type(now) is type(kept)


def test_setting_the_present_value_changes_nothing() -> None:
    bench = Bench()
    bench.may_change = False
    for row in SETTINGS:
        answer, texts, changes = bench.set(row.name, value_of(row, DEFAULT))
        assert answer == f32(value_of(row, DEFAULT))
        assert not texts
        assert not changes


def test_setting_the_configurations_value_removes_the_change() -> None:
    bench = Bench()
    bench.set("VINE_MAX_KPA", 15.0)
    bench.set("VINE_MAX_KPA", 20.7)  # as a 32-bit float it is above 20.7
    assert bench.parameters.config == DEFAULT
    assert bench.parameters.values == {}


REFUSED = [
    ("VINE_MAX_KPA", 20.8, "20.8 is outside 0.5 to 20.7"),
    ("VINE_MAX_KPA", 0.0, "0 is outside 0.5 to 20.7"),
    ("VINE_MAX_RATE", 61.0, "61 is outside 1 to 60"),
    ("VINE_MIN_ALT_M", 1.0, "1 is outside 2 to 1000"),
    ("VINE_RESERVE_KPA", 39.0, "39 is outside 40 to 2000"),
    ("VINE_RC_LOSS_S", 2.0, "2 is outside 0.3 to 1"),
    ("VINE_AP_LOSS_S", 1.0, "1 is outside 1.5 to 3"),
    ("VINE_HOLD_MAX_S", 31.0, "31 is outside 0.5 to 30"),
    ("VINE_MAX_BENT_S", 121.0, "121 is outside 1 to 120"),
    ("VINE_SW_CHAN", 19.0, "19 is outside 6 to 18"),
    ("VINE_SW_CHAN", 3.0, "3 is outside 6 to 18"),
    ("VINE_SW_CHAN", 5.0, "5 is outside 6 to 18"),
    ("VINE_SW_CHAN", 8.5, "8.5 is not a whole number"),
    ("VINE_RC_ACTION", 2.0, "2 is outside 0 to 1"),
    ("VINE_RC_ACTION", 0.5, "0.5 is not a whole number"),
    ("VINE_RATE_HZ", 11.0, "11 is outside 0.1 to 10"),
    ("VINE_MAX_KPA", math.nan, "it must be a number"),
    ("VINE_SW_CHAN", math.inf, "it must be a number"),
    ("VINE_MAX_KPA", -math.inf, "it must be a number"),
]


@pytest.mark.parametrize(("name", "value", "reason"), REFUSED)
def test_after_a_refusal_the_sender_gets_the_old_value_and_the_reason(
    name: str, value: float, reason: str
) -> None:
    bench = Bench()
    answer, texts, changes = bench.set(name, value)
    before = value_of(BY_NAME[name], DEFAULT)
    assert answer == f32(before)
    assert texts == [f"Vine: {name} stays {before:g}: {reason}"]
    assert changes == []
    assert bench.parameters.config == DEFAULT


def test_the_channels_of_throttle_and_flight_mode_are_refused() -> None:
    bench = Bench(configured(switch={"throttle_channel": 7}))
    stays = "Vine: VINE_SW_CHAN stays 9: "
    assert bench.set("VINE_SW_CHAN", 7.0)[:2] == (
        9.0,
        [f"{stays}7 is the throttle's channel (switch.throttle_channel)"],
    )
    bench.parameters.mode_channel = 8
    assert bench.set("VINE_SW_CHAN", 8.0)[:2] == (9.0, [f"{stays}8 is the flight mode's channel"])
    assert bench.set("VINE_SW_CHAN", 10.0)[0] == 10.0
    assert bench.set("VINE_SW_HYST_US", 8.0)[0] == 8.0


@pytest.mark.parametrize("param_type", [kind for kind in range(12) if kind != REAL32])
def test_another_type_than_float_is_refused(param_type: int) -> None:
    answer, texts, changes = Bench().set("VINE_SW_CHAN", 7.0, param_type)
    assert (answer, changes) == (9.0, [])
    assert texts == ["Vine: VINE_SW_CHAN stays 9: send it as REAL32"]


def test_while_the_vine_is_bent_only_parameters_of_the_telemetry_may_change() -> None:
    bench = Bench()
    bench.may_change = False
    for row in SETTINGS:
        before = value_of(row, DEFAULT)
        other = next(value for value in bounds(row, DEFAULT) if value != before)
        answer, texts, changes = bench.set(row.name, other)
        if row.table == "telemetry":
            assert (answer, len(changes)) == (f32(other), 1)
        else:
            assert (answer, changes) == (f32(before), [])
            assert texts == [f"Vine: {row.name} stays {before:g}: vent the vine first"]


def test_the_configuration_is_the_ceiling_not_the_default() -> None:
    bench = Bench(configured(limits={"max_kPa": 24.0}, interlocks={"min_altitude_m": 0.5}))
    assert bench.set("VINE_MAX_KPA", 23.0)[0] == 23.0
    assert bench.set("VINE_MIN_ALT_M", 1.0)[0] == 1.0
    assert bench.set("VINE_MIN_ALT_M", 0.25)[0] == 1.0


def test_a_configuration_beyond_a_rows_own_bounds_is_its_own_bound() -> None:
    row = BY_NAME["VINE_MIN_ALT_M"]
    assert bounds(row, configured(interlocks={"min_altitude_m": 1500.0})) == (1500.0, 1500.0)
    assert bounds(BY_NAME["VINE_MAX_BENT_S"], configured(limits={"max_bent_s": 0.25})) == (0.25, 0.25)


def test_a_change_is_an_information_and_a_refusal_a_warning() -> None:
    parameters = Parameters(DEFAULT)
    for value, severity in ((18.0, Severity.INFO), (30.0, Severity.WARNING)):
        outputs = parameters.handle(0.0, sent(setting("VINE_MAX_KPA", value)), US, SENDER, True)
        assert [output.severity for output in outputs if isinstance(output, Notice)] == [severity]


def test_saved_values_are_active_from_the_start() -> None:
    kept = {"VINE_MAX_KPA": 18.0, "VINE_RC_ACTION": 1.0}
    parameters = Parameters(DEFAULT, kept)
    assert parameters.config.limits.max_kPa == 18.0
    assert parameters.config.losses.on_rc_loss == "hold"
    assert parameters.values == kept
    with pytest.raises(ParameterRefused, match=r"VINE_MAX_KPA: 30 is outside 0\.5 to 20\.7"):
        Parameters(DEFAULT, {"VINE_MAX_KPA": 30.0})


ANY = st.floats(width=32) | st.floats(0, 130, width=32) | st.integers(0, 20).map(float)


@given(st.lists(st.tuples(st.sampled_from(SETTINGS), ANY, st.booleans()), max_size=25))
@settings(max_examples=examples(150), deadline=None)
def test_any_parameters_stay_within_the_configuration(
    sets: list[tuple[Any, float, bool]],
) -> None:
    bench = Bench(DEFAULT)
    for row, value, bench.may_change in sets:
        before = bench.parameters.config
        answer, texts, changes = bench.set(row.name, value)
        now = bench.parameters.config
        assert answer == f32(value_of(row, now))
        assert (now != before) == (len(changes) == 1)
        assert len(texts) <= 1
        least, most = bounds(row, DEFAULT)
        assert least <= value_of(row, now) <= most
    for strict in ("max_kPa", "max_rate_kPa_per_s", "max_bent_s", "overpressure_kPa"):
        assert getattr(bench.parameters.config.limits, strict) <= getattr(DEFAULT.limits, strict)
    assert Parameters(DEFAULT, bench.parameters.values).config == bench.parameters.config


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_the_shortest_decimal_is_the_same_float(value: float) -> None:
    assert f32(decimal(value)) == value


@pytest.mark.parametrize("value", [0.1, 0.15, 0.7, 20.7, 1e-3, 690.0, 59.999])
def test_a_decimal_survives_the_wire(value: float) -> None:
    assert decimal(f32(value)) == value

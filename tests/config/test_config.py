"""The configuration: every mistake gives one line that says where it is and what is wrong."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import examples
from flying_vines.config import config
from flying_vines.config.config import ITEM_COMMANDS, Config, ConfigError
from flying_vines.vine.profile import flatten

PROFILES = """
[profiles.straight]
segments = [{ kind = "step", to_kPa = 0 }]
[profiles.bend-half]
segments = [{ kind = "step", to_deg = 30 }]
[profiles.bend-full]
segments = [{ kind = "step", to_deg = 60 }]
"""
ONE_LINE = re.compile(r"my\.toml:(\d+): (?:([^:\n]+): )?[^\n]+")


def mistake(text: str, profiles: str = PROFILES) -> tuple[int, str, str]:
    """Line, key and complete text of the error of a configuration."""
    with pytest.raises(ConfigError) as caught:
        config.parse(text + "\n" + profiles, "my.toml")
    said = str(caught.value)
    found = ONE_LINE.fullmatch(said)
    assert found, said
    return int(found[1]), found[2] or "", said


def test_the_least_configuration_is_enough() -> None:
    assert config.parse(PROFILES, "my.toml").vehicle == config.VehicleConfig()


def test_the_built_in_configuration_says_what_the_defaults_are() -> None:
    built_in = config.default()
    for table in Config.__struct_fields__:
        if table in ("items", "profiles"):
            continue
        struct = type(getattr(built_in, table))
        assert getattr(built_in, table) == struct(), table


def test_the_built_in_configuration_shows_every_key() -> None:
    raw = tomllib.loads(config.default_text())
    built_in = config.default()
    for table in Config.__struct_fields__:
        value = getattr(built_in, table)
        if isinstance(value, msgspec.Struct):
            assert list(raw[table]) and set(raw[table]) == set(value.__struct_fields__), table


def test_every_profile_that_is_built_in_can_be_flown() -> None:
    built_in = config.default()
    for name in built_in.profiles:
        assert list(flatten(built_in.profiles, name))


def test_a_configuration_is_read_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(config.default_text(), encoding="utf-8")
    assert config.load(path) == config.default()
    path.write_text(config.default_text(), encoding="utf-8-sig")  # as some Windows editors do
    assert config.load(path) == config.default()


def test_files_that_cannot_be_read_give_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.toml: no such file; .*config init"):
        config.load(tmp_path / "nowhere.toml")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        config.load(tmp_path)
    binary = tmp_path / "flight.tlog"
    binary.write_bytes(b"\x00\x06\xfe\xfd\xff\x00\xff")
    with pytest.raises(ConfigError, match="cannot be read: it is not a UTF-8 text file"):
        config.load(binary)
    broken = tmp_path / "broken.toml"
    broken.write_text("\n\n[vehicle\n")
    with pytest.raises(ConfigError, match=rf"^{re.escape(str(broken))}:3: not TOML: "):
        config.load(broken)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("[vehicle\n", 1),
        ("[vehicle]\nlink = \n", 2),
        ("[vehicle]\n\nlink = udp\n", 3),
        ("[limits]\nmax_kPa = 1\nmax_kPa = 2\n", 3),
        ("[limits]\n[limits]\n", 2),
        ("just words\n", 1),
    ],
)
def test_a_file_that_is_not_toml(text: str, line: int) -> None:
    found_line, _, said = mistake(text)
    assert found_line == line
    assert ": not TOML: " in said


@pytest.mark.parametrize(
    ("text", "line", "remedy"),
    [
        ("[limits]\n[vine]\n[limits]", 3, "limits stands twice, first in line 1: keep one"),
        ("[limits]\nmax_kPa = 1\nmax_kPa = 2", 3, "limits.max_kPa stands twice, first in line 2: keep one"),
        ("[[items]]\n[items]", 2, "[items] and [[items]]: write it as in line 1"),
        ("x = { a = 1, a = 2 }", 1, "a stands twice in this line"),
        ("vehicle:\n  link: x", 1, "write = after the key, not :"),
        ("[switch]\nchannel: 9", 2, "write = after the key, not :"),
        ("[vehicle]\nlink = “udp”", 2, "write straight quotes"),
        ("[vehicle]\nlink = udp:x", 2, "write a text in quotes"),
        ('[vehicle]\nlink = "udp:x', 2, "the text has no closing quote"),
        ('[pneumatics]\nrig = "C:\\Users"', 2, "in a text is written"),
        ('[switch]\npositions = ["a", "b"\nchannel = 9', 2, "the list has no closing ]"),
        ("[profiles.x]\nsegments = [\n  { kind = 'hold' },\n\n[limits]", 2, "the list has no closing ]"),
        ("[limits\nmax_kPa = 1", 1, "the section has no closing ]"),
        ("[profiles.my vine]", 1, "a name with a space needs quotes"),
        ("[limits]\nmax_kPa = 20,7", 2, "write a point in a number"),
        ("[limits]\nmax_kPa = 20.7 kPa", 2, "write the number alone"),
        ("[limits]\nmax_kPa =   # none", 2, "the value after = is missing"),
        ("[limits]\nmax_kPa = = 2", 2, "write one ="),
        ("[limits]\nmax_kPa = .5", 2, "write digits before and after the point"),
        ("[limits]\nmax kPa = 5", 2, "write a key with a to z, and without spaces"),
        ("[switch]\nchannel = 09", 2, "without a leading 0"),
        ("[interlocks]\nbench_mode = True", 2, "write true or false"),
        ("[interlocks]\nbench_mode = yes", 2, "write true or false"),
        ("// mine", 1, "a comment begins with #"),
        ("x = { a = 1 b = 2 }", 1, "with commas between its keys"),
        ("x = { a = 1,\n b = 2 }", 1, "stands in one line"),
        ("just words", 1, "write key = value, [section] or # comment"),
    ],
)
def test_what_is_not_toml_is_named_with_the_remedy(text: str, line: int, remedy: str) -> None:
    found_line, _, said = mistake(text)
    assert remedy in said
    assert found_line == line


def test_a_text_that_ends_too_soon_and_one_that_nests_too_deep() -> None:
    with pytest.raises(ConfigError, match=r"^my\.toml:1: not TOML: "):
        config.parse('a = "', "my.toml")
    with pytest.raises(ConfigError, match="nested too deeply"):
        config.parse("a = " + "[" * 20_000, "my.toml")


TABLES = [name for name in Config.__struct_fields__ if name not in ("items", "profiles", "triggers")]
STEP = "segments = [{ kind = 'step', to_kPa = 0 }]"


@pytest.mark.parametrize("table", TABLES)
def test_a_misspelt_key_in_any_table_is_named_with_the_right_one(table: str) -> None:
    for key in getattr(config.default(), table).__struct_fields__:
        line, dotted, said = mistake(f"# my rig\n[{table}]\n{key}x = 1")
        assert (line, dotted) == (3, f"{table}.{key}x")
        assert said.endswith(f"unknown key; did you mean '{key}'?")


@pytest.mark.parametrize(
    ("text", "key", "meant"),
    [
        ("[limts]\nmax_kPa = 1", "limts", "limits"),
        ("[[itmes]]\ncommand = 'winch'", "itmes", "items"),
        ("[[items]]\ncommand = 'winch'\nprofil = 'straight'", "items[0].profil", "profile"),
        (
            f"[profiles.x]\nrepeet = 1\n{STEP}",
            "profiles.x.repeet",
            "repeat",
        ),
        (
            "[profiles.x]\nsegments = [{ kind = 'step', to_kpa = 0 }]",
            "profiles.x.segments[0].to_kpa",
            "to_kPa",
        ),
    ],
)
def test_misspelt_keys_elsewhere(text: str, key: str, meant: str) -> None:
    line, dotted, said = mistake(text)
    assert dotted == key
    assert f"did you mean '{meant}'?" in said
    assert line in (1, 2, 3)


@pytest.mark.parametrize(
    ("text", "instead"),
    [
        ("[limits]\nzzz = 1", "the keys here are max_bent_s, max_kPa, max_rate_kPa_per_s, overpressure_kPa"),
        ("[limits]\nmin_altitude_m = 1", "it belongs to [interlocks]"),
        ("# mine\nchannel = 9", "it belongs to [switch]"),
        (
            "[profiles.x]\nsegments = [{ kind = 'hold', for_s = 2, to_deg = 3 }]",
            "the keys here are for_s, kind",
        ),
    ],
)
def test_a_key_that_belongs_elsewhere(text: str, instead: str) -> None:
    line, key, said = mistake(text)
    assert (line, said) == (2, f"my.toml:2: {key}: unknown key; {instead}")


@pytest.mark.parametrize(
    ("text", "line", "key", "reason"),
    [
        ("[vehicle]\nlink = 5", 2, "vehicle.link", "must be a text in quotes, not 5"),
        ("[vehicle]\nsystem_id = 1.5", 2, "vehicle.system_id", "whole number from 0 to 255, not 1.5"),
        ("[vehicle]\nsystem_id = true", 2, "vehicle.system_id", "from 0 to 255, not true"),
        ("[vehicle]\nsystem_id = -1", 2, "vehicle.system_id", "from 0 to 255, not -1"),
        ("[vehicle]\nsystem_id = 256", 2, "vehicle.system_id", "from 0 to 255, not 256"),
        ("[vehicle]\nsystem_id = 99999999999999999999", 2, "vehicle.system_id", "more than 64 bits"),
        ("[vehicle]\ncomponent_id = 1", 2, "vehicle.component_id", "from 2 to 255, not 1"),
        ("[vehicle]\nrc_rate_Hz = 3.9", 2, "vehicle.rc_rate_Hz", "must be a number from 4 to 50, not 3.9"),
        ("[limits]\nmax_kPa = '5'", 2, "limits.max_kPa", "from 0.1 to 200, not '5'"),
        ("[limits]\nmax_kPa = 2020-01-01", 2, "limits.max_kPa", "not 2020-01-01"),
        ("[limits]\nmax_kPa = 0", 2, "limits.max_kPa", "from 0.1 to 200, not 0"),
        ("[limits]\nmax_kPa = 201", 2, "limits.max_kPa", "from 0.1 to 200, not 201"),
        ("[limits]\n\n# so\nmax_bent_s = -1", 4, "limits.max_bent_s", "from 0.1 to 3600, not -1"),
        ("limits = 5", 1, "limits", "must be a table, not 5"),
        ("items = 5", 1, "items", "must be a list of at most 1000 tables, not 5"),
        ("[switch]\nchannel = 19", 2, "switch.channel", "from 1 to 18, not 19"),
        ("[switch]\npositions = 'straight'", 2, "switch.positions", "a list of values, not 'straight'"),
        ("[switch]\npositions = ['straight', 5]", 2, "switch.positions[1]", "a text in quotes, not 5"),
        ("[losses]\non_rc_loss = 'land'", 2, "losses.on_rc_loss", "must be one of vent, hold, not 'land'"),
        ("[losses]\nrc_s = 20", 2, "losses.rc_s", "from 0.3 to 10, not 20"),
        ("[interlocks]\nbench_mode = 1", 2, "interlocks.bench_mode", "must be true or false, not 1"),
        ("[[items]]\nprofile = 'straight'", 1, "items[0]", "'command' is missing"),
        ("[[items]]\ncommand = 'gripper'\nbend = 'param9'", 3, "items[0].bend", "be one of param1, param2"),
        (
            "[[items]]\ncommand = 'gripper'\nmatch = { param9 = 1 }\nprofile = 'straight'",
            3, "items[0].match.param9", "must be one of param1, param2",
        ),
        (
            "[[items]]\ncommand = 'gripper'\nmatch = { param1 = 'x' }\nprofile = 'straight'",
            3, "items[0].match.param1", "must be a number, not 'x'",
        ),
        ("[[items]]\ncommand = 4.5\nprofile = 'straight'", 2, "items[0].command", "a text in quotes or"),
        ("[[items]]\ncommand = []\nprofile = 'straight'", 2, "items[0].command", "give at least one"),
        ("[[items]]\ncommand = ['winch', 'x']\nbend = 'param1'", 2, "items[0].command", "'x' must be"),
        ("[[items]]\ncommand = 'griper'\nprofile = 'straight'", 2, "items[0].command", "'griper' must be"),
        ("[[items]]\ncommand = 'gripper'", 1, "items[0]", "needs either profile or bend"),
        ("[[items]]\ncommand = 5\nprofile = 'x'\nbend = 'param1'", 1, "items[0]", "either profile or bend"),
        ("[vine]\ncurve = [[0, 0], [1]]", 2, "vine.curve[1]", "must be a list of 2 values, not [1]"),
        ("[vine]\ncurve = [[0, 0]]", 2, "vine.curve", "at least two pairs"),
        ("[vine]\ncurve = [[0, 0], [0, 5]]", 2, "vine.curve", "must rise"),
        ("[profiles.x]\nsegments = []", 1, "profiles.x", "at least one segment"),
        (f"[profiles.x]\nrepeat = 0\n{STEP}", 2, "profiles.x.repeat", "must be 1 to 1000, not 0"),
        ("[profiles.x]\nsegments = [{ to_kPa = 0 }]", 2, "profiles.x.segments[0]", "'kind' is missing"),
        (
            "[profiles.x]\nsegments = [\n  { kind = 'step', to_kPa = 0 },\n  { kind = 'stop' },\n]",
            2, "profiles.x.segments[1].kind", "one of step, ramp, hold, sine, profile, not 'stop'",
        ),
        ("[profiles.x]\nsegments = [{ kind = 'step' }]", 2, "profiles.x.segments[0]", "give either to_"),
        (
            "[profiles.x]\nsegments = [{ kind = 'hold', for_s = 0 }]",
            2, "profiles.x.segments[0].for_s", "must be from 0.0001 to 1000000, not 0",
        ),
        ("[profiles]\nx = 5", 2, "profiles.x", "must be a table, not 5"),
    ],
)  # fmt: skip
def test_wrong_types_and_values(text: str, line: int, key: str, reason: str) -> None:
    found_line, dotted, said = mistake(text)
    assert (found_line, dotted) == (line, key), said
    assert reason in said


@pytest.mark.parametrize("number", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(
    ("text", "line", "key"),
    [
        ("[[items]]\ncommand = 'winch'\nprofile = 'straight'\nscale = {}", 4, "items[0].scale"),
        ("[vine]\ncurve = [[0, 0], [5, {}]]", 2, "vine.curve[1][1]"),
        ("[profiles.x]\nsegments = [{{ kind = 'step', to_kPa = {} }}]", 2, "profiles.x.segments[0].to_kPa"),
        ("[profiles.x]\nsegments = [{{ kind = 'hold', for_s = {} }}]", 2, "profiles.x.segments[0].for_s"),
        (
            "[profiles.x]\nrate_kPa_per_s = {}\nsegments = [{{ kind = 'step', to_kPa = 0 }}]",
            2,
            "profiles.x.rate_kPa_per_s",
        ),
    ],
)
def test_numbers_that_are_none(text: str, line: int, key: str, number: str) -> None:
    found_line, dotted, said = mistake(text.format(number))
    assert (found_line, dotted) == (line, key), said


def test_every_number_of_every_table_must_be_one() -> None:
    built_in = config.default()
    for table in TABLES:
        for key, value in msgspec.structs.asdict(getattr(built_in, table)).items():
            if isinstance(value, float):
                for number in ("nan", "inf", "-inf"):
                    assert mistake(f"[{table}]\n{key} = {number}")[:2] == (2, f"{table}.{key}")


@pytest.mark.parametrize("count", [1, 4, 5, 7])
def test_a_switch_has_two_three_or_six_positions(count: int) -> None:
    line, dotted, said = mistake(f"[switch]\npositions = {['straight'] * count}")
    assert (line, dotted) == (2, "switch.positions")
    assert f"2, 3 or 6, not {count}" in said
    for good in (2, 3, 6):
        config.parse(f"[switch]\npositions = {['straight'] * good}\n{PROFILES}", "my.toml")


@pytest.mark.parametrize(
    ("text", "line", "key", "reason"),
    [
        ("[vehicle]\nlink = 'tcp:host'", 2, "vehicle.link", "'tcp:host' is not a link: give serial:"),
        (
            "[vehicle]\nlink = 'udpin:0.0.0.0:14540'",
            2, "vehicle.link", "anybody on the network could command the vine: name the sender "
            "(udpin:0.0.0.0:14540?peer=ADDRESS), listen on 127.0.0.1, or set vehicle.signing_key",
        ),
        ("[vehicle]\nlink = 'udpin:192.168.4.2:14540'", 2, "vehicle.link", "anybody on the network could"),
        ("[vehicle]\nlink = 'udpin:0.0.0.0:14540?peer=192.168.4.1'\n", 0, "", ""),
        ("[vehicle]\nlink = 'udpin:0.0.0.0:14540'\nsigning_key = 'key'\n", 0, "", ""),
        ("[firmware]\nlink = 'udpin:0.0.0.0:3000'", 2, "firmware.link", "anybody on the network could"),
        ("[firmware]\nlink = '/dev/ttyACM0'", 2, "firmware.link", "is not a link: give serial:"),
        (
            "[switch]\npositions = ['straight', 'bend-ful']",
            2, "switch.positions[1]", "there is no profile 'bend-ful'; did you mean 'bend-full'?",
        ),
        (
            "[[items]]\ncommand = 'winch'\nprofile = 'strait'",
            3, "items[0].profile", "there is no profile 'strait'; did you mean 'straight'?",
        ),
        ("[switch]\nchannel = 4", 2, "switch.channel", "4 is a stick's or the flight mode's channel: use"),
        ("[switch]\nchannel = 5", 2, "switch.channel", "5 is a stick's or the flight mode's channel: use"),
        ("[switch]\nchannel = 6\n", 0, "", ""),
        (
            "[switch]\nthrottle_channel = 9",
            1, "switch.channel", "9 is the throttle's channel (switch.throttle_channel)",
        ),
        (
            "[vehicle]\nlink = 'serial:/dev/ttyS1:57600'\n[firmware]\nlink = 'serial:/dev/ttyS1'",
            4, "firmware.link", "is the port of vehicle.link: the board needs its own",
        ),
        (
            "[vehicle]\nlink = 'udpin:127.0.0.1:3000'\n[firmware]\nlink = 'udpin:localhost:3000'",
            4, "firmware.link", "is the port of vehicle.link",
        ),
        (
            "[vehicle]\nlink = 'tcp:127.0.0.1:3000'\n[firmware]\nlink = 'tcp:127.0.0.1:3000'",
            4, "firmware.link", "is the port of vehicle.link",
        ),
        (
            "[vehicle]\nlink = 'usb:16c0:0483'\n[firmware]\nlink = 'usb:16c0:0483'",
            4, "firmware.link", "is the port of vehicle.link",
        ),
        ("[vehicle]\nlink = 'tcp:127.0.0.1:3000'\n[firmware]\nlink = 'tcp:127.0.0.2:3000'\n", 0, "", ""),
        ("[vehicle]\nlink = 'tcp:127.0.0.1:3000'\n[firmware]\nlink = 'tcp:127.0.0.1:3001'\n", 0, "", ""),
        ("[vehicle]\nlink = 'serial:/dev/ttyS1'\n[firmware]\nlink = 'tcp:127.0.0.1:3001'\n", 0, "", ""),
        ("[vehicle]\nlink = 'udpin:127.0.0.1:3000'\n[firmware]\nlink = 'tcp:127.0.0.1:3000'\n", 0, "", ""),
        ("[pneumatics]\nfull_kPa = 60", 2, "pneumatics.full_kPa", "reserve_kPa = 60.7: a full bend is"),
        ("[pneumatics]\nreservoir_volume_L = 0.002", 2, "pneumatics.reservoir_volume_L", "from 0.01 to 200"),
        (
            "[pneumatics]\nevp_flow_resistance_kPa_s_per_SL = 2.042",
            2, "pneumatics.evp_flow_resistance_kPa_s_per_SL", "from 10 to 1000000",
        ),
        (
            "[profiles.x]\nsegments = [{ kind = 'ramp', to_deg = 5, over_s = 1500 }]",
            1, "profiles.x", "longer than limits.max_bent_s",
        ),
        ("[firmware]\nsettings = { a = 1 }", 2, "firmware.settings", "a phloSAR has none"),
        ("[state]\nfolder = '~/vine'", 2, "state.folder", "~ and $ are not replaced"),
        ("[pneumatics]\nrig = '$HOME/rig.toml'", 2, "pneumatics.rig", "~ and $ are not replaced"),
        ("[vehicle]\nlink = 'serial:/dev/ttyAMA0:57600x'", 2, "vehicle.link", "'57600x' is no baud rate"),
        ("[vehicle]\nlink = 'serial:/dev/ttyAMA0:'", 2, "vehicle.link", "'' is no baud rate"),
        ("[vehicle]\nlink = 'serial:/dev/ttyAMA0:12'", 2, "vehicle.link", "'12' is no baud rate"),
        ("[vehicle]\nlink = 'serial:/dev/ttyAMA0,57600'", 2, "vehicle.link", "is no device"),
        ("[vehicle]\nlink = 'serial:ttyAMA0:57600'", 2, "vehicle.link", "write its whole path"),
        ("[vehicle]\nlink = 'serial:$PORT'", 2, "vehicle.link", "write its whole path"),
        ("[limits]\nmax_kPa = 30\n", 1, "limits.overpressure_kPa", "must be above max_kPa"),
        ("[limits]\nmax_kPa = 15\n", 0, "", ""),
        (
            "[vine]\ncurve = [[0, 0], [24, 60]]",
            2, "vine.curve", "the curve goes to 24 kPa, above limits.max_kPa = 20.7",
        ),
        ("[pneumatics]\ncycle_swing_kPa = 21", 2, "pneumatics.cycle_swing_kPa", "is above limits.max_kPa"),
        ("[profiles.x]\nsegments = [{ kind = 'step', to_deg = 61 }]", 1, "profiles.x", "outside the bend"),
        ("[profiles.x]\nsegments = [{ kind = 'step', to_kPa = 21 }]", 1, "profiles.x", "outside 0…20.7 kPa"),
        ("[profiles.x]\nsegments = [{ kind = 'step', to_kPa = -1 }]", 1, "profiles.x", "outside 0…20.7 kPa"),
        (
            "[profiles.x]\nsegments = [{ kind = 'profile', name = 'y' }]",
            1, "profiles.x", "there is no profile 'y'",
        ),
        (
            "[profiles.x]\nsegments = [{ kind = 'profile', name = 'x' }]",
            1, "profiles.x", "profile 'x' contains itself",
        ),
        (
            "[profiles.x]\nrepeat = 1000\nsegments = [{ kind = 'profile', name = 'straight', repeat = 11 }]",
            1, "profiles.x", "unrolls to more than 10000 segments",
        ),
        (
            "[profiles.x]\nsegments = [{ kind = 'sine', frequency_Hz = 1, from_kPa = 0, to_kPa = 20 }]",
            1, "profiles.x", "the sine needs 63 kPa/s, the rate limit is 60 kPa/s",
        ),
        (
            "[profiles.x]\nrate_kPa_per_s = 5\n"
            "segments = [{ kind = 'sine', frequency_Hz = 0.5, from_deg = 0, to_deg = 60 }]",
            1, "profiles.x", "the rate limit is 5 kPa/s",
        ),
    ],
)  # fmt: skip
def test_keys_that_do_not_fit_each_other(text: str, line: int, key: str, reason: str) -> None:
    if not reason:
        text = text + "[vine]\ncurve = [[0, 0], [14, 60]]\n[pneumatics]\ncycle_swing_kPa = 12"
        config.parse(text + PROFILES, "my.toml")
        return
    found_line, dotted, said = mistake(text)
    assert (found_line, dotted) == (line, key), said
    assert reason in said


def test_a_sine_just_within_the_limit_is_allowed() -> None:
    sine = "[profiles.x]\nsegments = [{ kind = 'sine', frequency_Hz = 0.95, from_kPa = 0, to_kPa = 20 }]"
    config.parse(sine + PROFILES, "my.toml")


def test_a_recorded_configuration_may_have_been_open() -> None:
    text = "[vehicle]\nlink = 'udpin:0.0.0.0:14540'\n" + PROFILES
    assert config.parse(text, "an old log", recorded=True).vehicle.link == "udpin:0.0.0.0:14540"


def test_a_recorded_configuration_may_have_its_switch_on_any_channel() -> None:
    assert config.parse("[switch]\nchannel = 5\n" + PROFILES, "an old log", recorded=True).switch.channel == 5


@pytest.mark.parametrize(
    ("table", "key", "beyond"),
    [
        ("limits", "max_bent_s", 3601),
        ("losses", "hold_at_most_s", 601),
        ("interlocks", "min_altitude_m", 1001),
        ("interlocks", "reserve_kPa", 2001),
        ("telemetry", "low_reservoir_cycles", 1001),
        ("log", "least_free_MB", 100_001),
        ("[items]", "scale", 10_001),
        ("[items]", "scale", -10_001),
        ("[items]", "command", 0),
        ("[items]", "command", 65536),
    ],
)
def test_numbers_that_no_rig_has_are_refused(table: str, key: str, beyond: int) -> None:
    rest = "" if key == "command" else "command = 'winch'\n"
    item = f"bend = 'param1'\n{rest}" if table == "[items]" else ""
    line, dotted, said = mistake(f"[{table}]\n{key} = {beyond}\n{item}")
    assert line == 2 or dotted.endswith(key), said
    assert "must be" in said


def test_the_second_of_two_items_is_the_one_at_fault() -> None:
    text = (
        "[[items]]\ncommand = 'winch'\nprofile = 'straight'\n\n[[items]]\ncommand = 'winch'\nprofile = 'no'"
    )
    assert mistake(text)[:2] == (7, "items[1].profile")


def test_names_in_quotes_and_lines_behind_odd_characters_are_found() -> None:
    text = "# a\u2028b\u0085c\n[profiles.\"x y\"]\nsegments = [{ kind = 'step', to_deg = 99 }]"
    assert mistake(text)[0] == 2
    assert mistake("limits.max_kPa = -1")[:2] == (1, "limits.max_kPa")
    assert mistake("vehicle = { link = 'x' }")[0] == 1


def test_positions_may_be_empty_and_commands_may_be_numbers() -> None:
    text = "[switch]\npositions = ['', 'straight']\n[[items]]\ncommand = 31010\nbend = 'param1'\n"
    parsed = config.parse(text + PROFILES, "my.toml")
    assert parsed.switch.positions == ("", "straight")
    assert parsed.items[0].command_ids == (31010,)
    for name, number in ITEM_COMMANDS.items():
        item = config.parse(f"[[items]]\ncommand = '{name}'\nbend = 'param1'\n{PROFILES}", "my.toml").items[0]
        assert item.command_ids == (number,)


def test_one_rule_may_serve_several_commands() -> None:
    text = "[[items]]\ncommand = ['script_message', 'user_1', 42]\nbend = 'param7'\n"
    assert config.parse(text + PROFILES, "my.toml").items[0].command_ids == (217, 31010, 42)


# Any text.

SEGMENT_KEYS = [
    "kind", "to_kPa", "to_deg", "over_s", "for_s", "frequency_Hz", "cycles", "from_kPa", "name", "repeat",
]  # fmt: skip
KEYS = sorted(
    {*Config.__struct_fields__, *SEGMENT_KEYS, "segments", "x y", "", "é"}
    | {key for table in TABLES for key in getattr(config.default(), table).__struct_fields__}
)
scalars = st.one_of(
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["step", "sine", "hold", "vent", "straight", "winch", "tcp:a:1"]),
    st.dates(),
)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.sampled_from(KEYS), inner, max_size=4)
    ),
    max_leaves=12,
)


def toml(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case int():
            return str(value)
        case float():
            return str(value)
        case str():
            return '"' + "".join(f"\\U{ord(sign):08X}" for sign in value) + '"'
        case list():
            return "[" + ", ".join(toml(part) for part in value) + "]"
        case dict():
            return "{" + ", ".join(f"{toml(key)} = {toml(part)}" for key, part in value.items()) + "}"
        case _:
            return str(value)


def parses_or_is_refused(text: str) -> None:
    try:
        config.parse(text, "my.toml")
    except ConfigError as error:
        said = str(error)
        assert said.startswith("my.toml:")
        assert len(said.splitlines()) == 1


@given(st.dictionaries(st.one_of(st.sampled_from(KEYS), st.text(max_size=5)), values, max_size=6))
@settings(max_examples=examples(100), deadline=None)
def test_any_toml_parses_or_is_refused_in_one_line(tables: dict[str, Any]) -> None:
    parses_or_is_refused("\n".join(f"{toml(key)} = {toml(value)}" for key, value in tables.items()))


@given(table=st.sampled_from(TABLES), data=st.data())
@settings(max_examples=examples(150), deadline=None)
def test_any_value_of_any_key_parses_or_is_refused(table: str, data: st.DataObject) -> None:
    fields = getattr(config.default(), table).__struct_fields__
    keys = data.draw(st.dictionaries(st.sampled_from(fields), st.one_of(scalars, values), max_size=3))
    lines = [f"{key} = {toml(value)}" for key, value in keys.items()]
    parses_or_is_refused("\n".join([f"[{table}]", *lines, PROFILES]))


@given(st.lists(st.dictionaries(st.sampled_from(SEGMENT_KEYS), scalars, max_size=5), max_size=4))
@settings(max_examples=examples(100), deadline=None)
def test_any_segments_parse_or_are_refused(parts: list[dict[str, Any]]) -> None:
    parses_or_is_refused(f"{PROFILES}\n[profiles.x]\nsegments = {toml(parts)}")


@given(st.text(max_size=200))
@settings(max_examples=examples(50), deadline=None)
def test_any_text_parses_or_is_refused(text: str) -> None:
    parses_or_is_refused(text)


@given(at=st.integers(0, 20_000), length=st.integers(0, 40), put=st.text(max_size=10))
@settings(max_examples=examples(100), deadline=None)
def test_any_slip_in_the_built_in_configuration_parses_or_is_refused(at: int, length: int, put: str) -> None:
    whole = config.default_text()
    at %= len(whole)
    parses_or_is_refused(whole[:at] + put + whole[at + length :])


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("[log]\n", "[calibration]\nsteps = 6\nhold_s = 3\n[log]\n"),
        ("[telemetry]\n", "[telemetry]\nfuel_status = true\n"),
        ("[losses]\n", "[losses]\non_autopilot_loss = 'hold'\n"),
        ("[mqtt]\n", "[mqtt]\nkept_events = 100\n"),
    ],
)
def test_settings_of_an_earlier_version_are_ignored_with_a_line(before: str, after: str) -> None:
    text = config.default_text()
    old = re.sub(rf"^{re.escape(before.strip())}.*\n", after, text, flags=re.MULTILINE)
    assert old != text
    assert config.parse(old, "test") == config.default()
    (line,) = config.ignored(old, "my.toml", config.OLD_SETTINGS)
    assert re.match(r"my\.toml:\d+: [a-z_.]+: is ignored, delete it: ", line)
    assert not config.ignored(text, "my.toml", config.OLD_SETTINGS)


def test_a_setting_is_read_by_the_name_of_an_earlier_version_and_a_line_says_the_new_one() -> None:
    old = config.default_text().replace('reservoir_loss = "fault"', 'bottle_loss = "warn"')
    assert config.parse(old, "test").checks.reservoir_loss == "warn"
    (line,) = config.renamed(old, "my.toml")
    assert re.fullmatch(r"my\.toml:\d+: checks\.bottle_loss: is called reservoir_loss now: rename it", line)

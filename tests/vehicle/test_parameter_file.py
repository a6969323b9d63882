"""The parameter file is written whole or not at all, and its errors name the line."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from examples import examples
from flying_vines.config import config
from flying_vines.vehicle.component.parameter_file import ParameterFileError, ignored_in, read, write
from flying_vines.vehicle.component.parameter_table import SETTINGS, ParameterRefused, bounds
from flying_vines.vehicle.component.parameters import Parameters

CONFIG = config.default()
VALUES = {"VINE_MAX_KPA": 18.1, "VINE_RC_ACTION": 1.0}
TEXT = """\
# Without "# end" as its last line this file is cut off.
# Vine parameters set from a ground station. They override the configuration.
# To use the configuration's value again, delete the line and restart the service.

# RC lost: 0 vent, 1 hold (configuration: 0)
VINE_RC_ACTION = 1.0

# maximum setpoint, gauge kPa (configuration: 20.7)
VINE_MAX_KPA = 18.1

# end
"""


def test_written_parameters_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "vine-parameters.toml"
    write(path, VALUES, CONFIG)
    assert path.read_text() == TEXT
    assert read(path, CONFIG) == VALUES
    assert Parameters(CONFIG, read(path, CONFIG)).config.limits.max_kPa == 18.1
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o644


@given(st.data())
@settings(max_examples=examples(40), deadline=None)
def test_any_set_of_allowed_values_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("state") / "parameters.toml"
    rows = data.draw(st.lists(st.sampled_from(SETTINGS), unique=True))
    values = {}
    for row in rows:
        least, most = bounds(row, CONFIG)
        whole = bool(row.choices) or row.key == "channel"
        number = st.integers(int(least), int(most)).map(float) if whole else st.floats(least, most)
        values[row.name] = data.draw(number)
    try:
        Parameters(CONFIG, values)
    except ParameterRefused:
        reject()
    write(path, values, CONFIG)
    assert read(path, CONFIG) == values


@pytest.mark.parametrize("values", [VALUES, {}], ids=["two values", "none"])
def test_a_file_that_was_cut_off_anywhere_is_refused(tmp_path: Path, values: dict[str, float]) -> None:
    path = tmp_path / "parameters.toml"
    write(path, values, CONFIG)
    text = path.read_text().rstrip()
    for length in range(len(text)):
        path.write_text(text[:length])
        with pytest.raises(ParameterFileError):
            read(path, CONFIG)


def test_a_file_of_an_earlier_version_or_a_person_needs_no_end(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    for text in (
        TEXT.partition("\n")[2].removesuffix("\n# end\n"),
        "VINE_RC_ACTION = 1\nVINE_MAX_KPA = 18.1",
    ):
        path.write_text(text)
        assert read(path, CONFIG) == VALUES


def test_without_a_file_there_are_no_values(tmp_path: Path) -> None:
    assert read(tmp_path / "none.toml", CONFIG) == {}


def test_a_folder_that_is_not_there_is_made(tmp_path: Path) -> None:
    path = tmp_path / "state" / "vine" / "parameters.toml"
    write(path, VALUES, CONFIG)
    assert read(path, CONFIG) == VALUES


def test_the_last_write_counts(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    write(path, VALUES, CONFIG)
    write(path, {"VINE_SW_CHAN": 7.0}, CONFIG)
    assert read(path, CONFIG) == {"VINE_SW_CHAN": 7.0}


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("VINE_SW_CHAN = 7\nVINE_MAX_KPA = 30\n", ":2: VINE_MAX_KPA: 30 is outside 0.5 to 20.7: correct"),
        ("VINE_SW_CHAN = 7.5\n", ":1: VINE_SW_CHAN: 7.5 is not a whole number: correct"),
        ("VINE_MAX_KPA = nan\n", ":1: VINE_MAX_KPA: it must be a number: correct"),
        ("VINE_MAX_KPA = 1e300\n", ":1: VINE_MAX_KPA: 1e+300 is outside 0.5 to 20.7: correct"),
        ("\n\nVINE_MAX_KPA = 'low'\n", ":3: VINE_MAX_KPA: it must be a number"),
        ("VINE_RATE_HZ = true\n", ":1: VINE_RATE_HZ: it must be a number"),
        ("VINE_MAX_KPB = 3\n", ":1: VINE_MAX_KPB: there is no such parameter; did you mean VINE_MAX_KPA?"),
        ("[limits]\nmax_kPa = 3\n", ":1: limits: there is no such parameter: delete the line"),
        ("VINE_MAX_KPA = 18\nVINE_MAX_K", ":2: not TOML: "),
        ("VINE_MAX_KPA = 18\nVINE_MAX_KPA = 17\n", ":2: not TOML: "),
        ("\x00\x00\x00", ":1: not TOML: "),
        # A power cut may leave an empty file. It must not end a limit from the field unseen.
        ("", ": is empty or cut off: parameters are lost; set them again after deleting the file"),
        (" \n\n", ": is empty or cut off: parameters are lost; set them again after deleting the file"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_the_line(tmp_path: Path, text: str, error: str) -> None:
    path = tmp_path / "parameters.toml"
    path.write_text(text)
    with pytest.raises(ParameterFileError) as caught:
        read(path, CONFIG)
    assert str(caught.value).startswith(f"{path}{error}")
    assert ("not TOML" in error) <= str(caught.value).endswith("set them again after deleting the file")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content", [b"VINE_MAX_KPA = 18\nVINE_MA", b"\x00" * 40, b"\xff\xfe", b"[limits]\nmax_kPa = 18\n"]
)
def test_a_file_that_is_not_a_parameter_file_is_never_overwritten(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "parameters.toml"
    path.write_bytes(content)
    with pytest.raises(ParameterFileError):
        write(path, VALUES, CONFIG)
    assert path.read_bytes() == content


@pytest.mark.parametrize("name", ["VINE_AP_ACTION", "VINE_FUEL_STATUS"])
def test_a_parameter_of_an_earlier_version_is_ignored_with_a_line(tmp_path: Path, name: str) -> None:
    path = tmp_path / "parameters.toml"
    path.write_text(f"VINE_MAX_KPA = 18\n{name} = 1\n")
    assert read(path, CONFIG) == {"VINE_MAX_KPA": 18.0}
    (line,) = ignored_in(path)
    assert line.startswith(f"{path}:2: {name}: is ignored, delete it: ")


def test_a_file_whose_values_the_configuration_no_longer_allows_may_be_written_anew(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    path.write_text("VINE_MAX_KPA = 30\n")
    write(path, VALUES, CONFIG)
    assert read(path, CONFIG) == VALUES


def test_a_failure_half_way_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "parameters.toml"
    write(path, VALUES, CONFIG)

    def disk_full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", disk_full)
    with pytest.raises(ParameterFileError) as caught:
        write(path, {"VINE_SW_CHAN": 7.0}, CONFIG)
    assert str(caught.value) == f"{path}: cannot be written: No space left on device"
    monkeypatch.undo()
    assert read(path, CONFIG) == VALUES
    assert list(tmp_path.iterdir()) == [path]


def test_the_new_file_is_on_the_disk_before_it_replaces_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def watched_fsync(number: int) -> None:
        done.append("folder" if stat.S_ISDIR(os.fstat(number).st_mode) else "file")
        fsync(number)

    def watched_replace(self: Path, target: Path) -> Path:
        done.append("replace")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", watched_fsync)
    monkeypatch.setattr(Path, "replace", watched_replace)
    write(tmp_path / "parameters.toml", VALUES, CONFIG)
    assert done == ["file", "replace", "folder"]


def test_a_place_that_cannot_be_written_is_reported_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ParameterFileError, match="cannot be written: "):
        write(tmp_path / "file" / "parameters.toml", VALUES, CONFIG)

"""A configuration that is written as text and read again is equal."""

from __future__ import annotations

import msgspec
import pytest

from flying_vines.calibration.plan import CalibrationRequest, plan
from flying_vines.config import config as configuration
from flying_vines.config.config import ChecksConfig, Config, FirmwareConfig, TriggerConfig
from flying_vines.config.config_text import configuration_text

DEFAULT = configuration.default()
UNUSUAL = msgspec.structs.replace(
    DEFAULT,
    profiles={**DEFAULT.profiles, 'a "b" \\ c': DEFAULT.profiles["wave"]},
    firmware=FirmwareConfig(kind="pump", settings={"band kPa": 0.5, "port": "a"}),
    checks=ChecksConfig(own={"stuck": "warn"}),
    triggers=(TriggerConfig("gust", "wave", {"angle_deg": 20.0}), TriggerConfig("quake", "wave")),
    mqtt=msgspec.structs.replace(DEFAULT.mqtt, commands=("vent", "bend")),
)


@pytest.mark.parametrize(
    "config",
    [
        DEFAULT,
        UNUSUAL,
        plan(DEFAULT, CalibrationRequest()).config,
    ],
    ids=["default", "unusual", "of a calibration"],
)
def test_a_written_configuration_reads_back_equal(config: Config) -> None:
    assert configuration.parse(configuration_text(config), "the text") == config

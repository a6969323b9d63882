"""The table [vine]: hysteresis is checked, also for swings."""

from __future__ import annotations

import pytest

from flying_vines.config import config
from flying_vines.config.config import ConfigError
from flying_vines.vine.motion import plan
from flying_vines.vine.profile import Sine, ends_kPa

PROFILES = """
[profiles.straight]
segments = [{ kind = "step", to_kPa = 0 }]
[profiles.wave]
segments = [{ kind = "sine", from_deg = 15, to_deg = 45, frequency_Hz = 1.0 }]
[switch]
positions = ["straight", "wave"]
"""


def parsed(vine: str, limits: str = "") -> config.Config:
    return config.parse(f"[vine]\ncurve = [[0, 0], [4, 0], [20, 60]]\n{vine}\n{limits}{PROFILES}", "my.toml")


@pytest.mark.parametrize(
    ("vine", "says"),
    [
        ("hysteresis_kPa = -1", "my.toml:3: vine.hysteresis_kPa: must be a number from 0 to 200, not"),
        (
            "hysteresis_kPa = 20",
            "my.toml:3: vine.hysteresis_kPa: the hysteresis must be 0 or more, and narrower",
        ),
        ("hysteresis_kPa = nan", "my.toml:3: vine.hysteresis_kPa: must be a number from 0 to 200, not"),
        ("hysteresis = 2", "my.toml:3: vine.hysteresis: unknown key; did you mean 'hysteresis_kPa'?"),
    ],
)
def test_an_invalid_hysteresis_names_its_key(vine: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parsed(vine)
    assert says in str(caught.value)


def test_a_swing_must_be_slow_enough_with_its_hysteresis() -> None:
    # Angles of 15 and 45° are 8 kPa apart; the swing of the pressure is 11 kPa.
    limits = "[limits]\nmax_rate_kPa_per_s = 30\n"
    assert parsed("hysteresis_kPa = 0", limits).vine.hysteresis_kPa == 0.0
    with pytest.raises(
        ConfigError, match=r"profiles\.wave: the sine needs 35 kPa/s, the rate limit is 30 kPa/s"
    ):
        parsed("hysteresis_kPa = 3", limits)


def test_a_swing_between_one_angle_moves_nothing() -> None:
    curve = parsed("hysteresis_kPa = 3").vine.bend_curve()
    still = Sine(frequency_Hz=1.0, from_deg=30, to_deg=30)
    assert ends_kPa(still, curve) == (12.0, 12.0)
    motion = plan([still], curve, 12.0, 60.0, 20.0)
    assert {motion.setpoint_kPa(t / 10) for t in range(15)} == {12.0}

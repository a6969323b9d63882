"""The configuration of the whole rig: one TOML file, as frozen structures. Unknown keys are errors."""

from __future__ import annotations

import difflib
import ipaddress
import math
import re
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import msgspec
from msgspec import Meta

from flying_vines.config.address import (
    NetworkAddress,
    parse_address,
    parse_broker,
    same_port,
    who_can_command,
)
from flying_vines.config.plugins import PluginError, installed, put_in, with_own_segments
from flying_vines.files.toml_text import (
    Key,
    OneLineError,
    dotted,
    explained,
    lines_of_keys,
    located,
    not_finite,
    parsed,
    place,
    read_text,
)
from flying_vines.vine.curve import BendCurve
from flying_vines.vine.intent import CommandName
from flying_vines.vine.profile import PressureProfile, Ramp, Segment, Sine, ends_kPa, flatten

ITEM_COMMANDS = {
    "script_message": 217,
    "script_time": 42702,
    "gripper": 211,
    "winch": 42600,
    "actuator": 187,
    "relay": 181,
    "servo": 183,
    "aux_function": 218,
    "user_1": 31010,
}
"""MAVLink commands that may carry a vine item, by their names in the configuration."""

_TOPIC_LEVEL = re.compile(r"[\w.-]{1,64}", re.ASCII)

MAX_PROFILES = 200
"""The page has a button for each, and each may unroll to 10,000 segments."""
MAX_ITEMS = 1000

CheckLevel = Literal["fault", "warn"]

SEGMENTS = tuple(str(segment.__struct_config__.tag) for segment in get_args(Segment))
"""The built-in kinds of segments."""

Param = Literal["param1", "param2", "param3", "param4", "param5", "param6", "param7"]
"""A parameter of a mission item or command; param5 … param7 are an item's x, y and z."""


def param_index(param: Param) -> int:
    """The index of a parameter in a list of all: 0 for param1."""
    return int(param.removeprefix("param")) - 1


# Generous: a hundred times what rigs have, so that no arithmetic overflows.
ReservoirPressure = Annotated[float, Meta(ge=0, le=5000)]
VinePressure = Annotated[float, Meta(ge=0, le=200)]
Rate = Annotated[float, Meta(ge=0.01, le=2000)]
# A unit that is wrong by a thousand is outside: Pa for kPa, mL or m³ for L.
ReservoirVolume = Annotated[float, Meta(ge=0.01, le=200)]
VineVolume = Annotated[float, Meta(ge=0.001, le=50)]
FlowResistance = Annotated[float, Meta(ge=10, le=1e6)]
CurveKPa = Annotated[float, Meta(ge=-200, le=200)]
CurveDeg = Annotated[float, Meta(ge=-3600, le=3600)]
CommandId = Annotated[int, Meta(ge=1, le=65_535)]


class ConfigError(OneLineError):
    """The configuration is invalid; the text names file, key and line, and what to do."""


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    pass


class VehicleConfig(_Table, frozen=True):
    link: str = "udpin:127.0.0.1:14540"
    system_id: Annotated[int, Meta(ge=0, le=255)] = 0
    component_id: Annotated[int, Meta(ge=2, le=255)] = 191  # 1 is the autopilot
    rc_rate_Hz: Annotated[float, Meta(ge=4, le=50)] = 20.0
    signing_key: str = ""

    @property
    def who_can_command(self) -> str:
        """One line on who can command the vine over the link."""
        return who_can_command(parse_address(self.link), bool(self.signing_key))


PHLOSAR = "phlosar"

Setting = float | str
"""A setting of a part of an installed package."""


class FirmwareConfig(_Table, frozen=True):
    """The actuator. `kind`: a phloSAR, or an actuator of an installed package, with its settings."""

    link: str = "serial:/dev/ttyACM0"
    kind: str = PHLOSAR
    settings: dict[str, Setting] = {}

    @property
    def name(self) -> str:
        """The actuator in texts for the pilot."""
        return "phloSAR" if self.is_phlosar else self.kind

    @property
    def is_phlosar(self) -> bool:
        """True for a phloSAR: only it has a reservoir to estimate and a firmware to calibrate."""
        return self.kind == PHLOSAR


ReceiverFailsafe = Literal["unknown", "hold", "hidden"] | Annotated[int, Meta(ge=800, le=2200)]
"""The switch channel's value while the transmitter is lost; `flying-vines doctor --radio` measures it."""


FIRST_FREE_CHANNEL = 6
"""Channels 1 to 4 are the sticks; 5 is ArduCopter's flight mode (FLTMODE_CH), and usually PX4's."""


class SwitchConfig(_Table, frozen=True):
    positions: tuple[str, ...] = ("straight", "bend-half", "bend-full")
    channel: Annotated[int, Meta(ge=1, le=18)] = 9
    debounce_s: Annotated[float, Meta(ge=0.1, le=2)] = 0.15
    settle_s: Annotated[float, Meta(ge=0.2, le=10)] = 1.0
    hysteresis_us: Annotated[float, Meta(ge=0, le=60)] = 25.0
    throttle_channel: Annotated[int, Meta(ge=0, le=18)] = 3
    throttle_failsafe_us: Annotated[float, Meta(ge=0, le=1200)] = 975.0
    receiver_failsafe: ReceiverFailsafe = "unknown"

    def __post_init__(self) -> None:
        if len(self.positions) not in (2, 3, 6):
            raise ValueError(f"positions: a switch has 2, 3 or 6, not {len(self.positions)}")

    @property
    def channel_problem(self) -> str:
        """Why the switch cannot have its channel, because the pilot flies with it; empty if it can."""
        if self.channel < FIRST_FREE_CHANNEL:
            return f"{self.channel} is a stick's or the flight mode's channel: use another from 6 to 18"
        if self.channel == self.throttle_channel:
            return f"{self.channel} is the throttle's channel (switch.throttle_channel)"
        return ""


class ItemConfig(_Table, frozen=True):
    """A rule: what a mission item or command does with the vine."""

    command: str | CommandId | tuple[str | CommandId, ...]
    match: dict[Param, float] = {}
    profile: str | None = None
    bend: Param | None = None
    scale: Annotated[float, Meta(ge=-10_000, le=10_000)] = 1.0

    def __post_init__(self) -> None:
        for name in self._commands:
            if isinstance(name, str) and name not in ITEM_COMMANDS:
                raise ValueError(
                    f"command: '{name}' must be one of {', '.join(ITEM_COMMANDS)}, or a MAV_CMD number"
                )
        if not self._commands:
            raise ValueError("command: is empty: give at least one")
        if (self.profile is None) == (self.bend is None):
            raise ValueError("an item needs either profile or bend")

    @property
    def command_ids(self) -> tuple[int, ...]:
        """The MAV_CMD numbers, in the order given."""
        return tuple(ITEM_COMMANDS[name] if isinstance(name, str) else name for name in self._commands)

    @property
    def _commands(self) -> tuple[str | int, ...]:
        return self.command if isinstance(self.command, tuple) else (self.command,)


class TriggerConfig(_Table, frozen=True):
    """A trigger of an installed package, and the profile that it starts."""

    kind: str
    profile: str
    settings: dict[str, Setting] = {}


class VineConfig(_Table, frozen=True):
    curve: Annotated[tuple[tuple[CurveKPa, CurveDeg], ...], Meta(max_length=1000)] = (
        (0.0, 0.0),
        (2.0, 0.0),
        (20.7, 60.0),
    )
    hysteresis_kPa: VinePressure = 0.0

    def __post_init__(self) -> None:
        try:
            BendCurve(self.curve)
        except ValueError as error:
            raise ValueError(f"curve: {error}") from None

    def bend_curve(self) -> BendCurve:
        return BendCurve(self.curve, self.hysteresis_kPa)


class LimitsConfig(_Table, frozen=True):
    max_kPa: Annotated[float, Meta(ge=0.1, le=200)] = 20.7
    max_rate_kPa_per_s: Rate = 60.0
    max_bent_s: Annotated[float, Meta(ge=0.1, le=3600)] = 120.0
    overpressure_kPa: Annotated[float, Meta(ge=0.1, le=206)] = 25.0

    def __post_init__(self) -> None:
        if self.overpressure_kPa <= self.max_kPa:
            raise ValueError("overpressure_kPa must be above max_kPa")


class InterlocksConfig(_Table, frozen=True):
    bench_mode: bool = False
    armed_at_start: bool = True
    min_altitude_m: Annotated[float, Meta(ge=0, le=1000)] = 2.0
    reserve_kPa: Annotated[float, Meta(ge=0, le=2000)] = 40.0


class LossesConfig(_Table, frozen=True):
    """Timeouts of the inputs, and the response to RC loss."""

    rc_s: Annotated[float, Meta(ge=0.3, le=10)] = 1.0
    autopilot_s: Annotated[float, Meta(ge=1.5, le=30)] = 3.0
    telemetry_s: Annotated[float, Meta(ge=0.1, le=2)] = 0.3
    on_rc_loss: Literal["vent", "hold"] = "vent"
    hold_at_most_s: Annotated[float, Meta(ge=0.1, le=600)] = 30.0


class PneumaticsConfig(_Table, frozen=True):
    """The rig's numbers for the reservoir estimate. The defaults are those of the paper's demonstration.

    EVP: inflation valve. DVP: the Venturi's supply valve.
    """

    rig: str = ""
    reservoir_volume_L: ReservoirVolume = 2.0
    full_kPa: Annotated[float, Meta(ge=10, le=5000)] = 690.0
    cv_volume_L: VineVolume = 0.1
    evp_flow_resistance_kPa_s_per_SL: FlowResistance = 2042.0
    dvp_flow_resistance_kPa_s_per_SL: FlowResistance = 618.0
    venturi_least_supply_kPa: ReservoirPressure = 100.0
    cycle_swing_kPa: Annotated[float, Meta(ge=0.1, le=200)] = 20.7
    cycle_rate_kPa_per_s: Rate = 22.8


class ChecksConfig(_Table, frozen=True):
    """Response to each failed physics check, and the rig's tolerances."""

    volume_factor: Annotated[float, Meta(ge=1, le=10)] = 2.0
    zero_kPa: Annotated[float, Meta(ge=1, le=50)] = 4.0
    filling: CheckLevel = "fault"
    venting: CheckLevel = "fault"
    below_setpoint: CheckLevel = "warn"
    above_setpoint: CheckLevel = "fault"
    sudden_fall: CheckLevel = "fault"
    vine_sensor: CheckLevel = "fault"
    vine_zero: CheckLevel = "fault"
    reservoir_loss: CheckLevel = "fault"
    reservoir_sensor: CheckLevel = "warn"
    reservoir_hot: CheckLevel = "warn"
    vine_leak: CheckLevel = "warn"
    unsteady: CheckLevel = "warn"
    own: dict[str, CheckLevel] = {}
    """Checks of installed packages."""


class TelemetryConfig(_Table, frozen=True):
    rate_Hz: Annotated[float, Meta(ge=0.1, le=10)] = 2.0
    low_reservoir_cycles: Annotated[float, Meta(ge=0, le=1000)] = 10.0


class PageConfig(_Table, frozen=True):
    """The status page that `run` serves."""

    host: str = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535)] = 8017
    token_file: str = ""

    @property
    def needs_token(self) -> bool:
        """True if other computers can reach the page."""
        return self.port != 0 and not ipaddress.ip_address(self.host).is_loopback


class MqttConfig(_Table, frozen=True):
    """The MQTT broker: connection, reports, and permitted requests."""

    broker: str = ""
    prefix: str = "flying-vines"
    name: str = ""
    rate_Hz: Annotated[float, Meta(ge=0.1, le=10)] = 2.0
    username: str = ""
    password_file: str = ""
    ca_file: str = ""
    certificate_file: str = ""
    key_file: str = ""
    commands: tuple[CommandName, ...] = ()
    discovery_prefix: str = ""


class LogConfig(_Table, frozen=True):
    """The flight recorder."""

    least_free_MB: Annotated[float, Meta(ge=0, le=100_000)] = 200.0


class StateConfig(_Table, frozen=True):
    """Where the service stores its persistent state."""

    folder: str = ""


class Config(_Table, frozen=True):
    """The whole configuration."""

    profiles: Annotated[dict[str, PressureProfile], Meta(max_length=MAX_PROFILES)]
    vehicle: VehicleConfig = VehicleConfig()
    firmware: FirmwareConfig = FirmwareConfig()
    switch: SwitchConfig = SwitchConfig()
    items: Annotated[tuple[ItemConfig, ...], Meta(max_length=MAX_ITEMS)] = ()
    triggers: Annotated[tuple[TriggerConfig, ...], Meta(max_length=MAX_ITEMS)] = ()
    vine: VineConfig = VineConfig()
    limits: LimitsConfig = LimitsConfig()
    interlocks: InterlocksConfig = InterlocksConfig()
    losses: LossesConfig = LossesConfig()
    pneumatics: PneumaticsConfig = PneumaticsConfig()
    checks: ChecksConfig = ChecksConfig()
    telemetry: TelemetryConfig = TelemetryConfig()
    page: PageConfig = PageConfig()
    mqtt: MqttConfig = MqttConfig()
    log: LogConfig = LogConfig()
    state: StateConfig = StateConfig()


_PATHS = (
    ("vehicle", "signing_key"),
    ("pneumatics", "rig"),
    ("page", "token_file"),
    ("state", "folder"),
    *(("mqtt", name) for name in ("password_file", "ca_file", "certificate_file", "key_file")),
)


def default_text() -> str:
    """The built-in configuration, which `config init` writes."""
    return resources.files("flying_vines.config").joinpath("default.toml").read_text(encoding="utf-8")


def default() -> Config:
    return parse(default_text(), "the built-in configuration")


def load_or_default(path: Path | None) -> Config:
    """The configuration in a file, or the built-in one. Raises `ConfigError`."""
    return load(path) if path else default()


def load(path: Path) -> Config:
    """Read and check a configuration. Raises `ConfigError` with one line: file, key and line number."""
    return parse(text_of(path), str(path))


def rig_named(config: Config, config_file: Path | None) -> Path | None:
    """The rig file that a configuration names, or None. A relative path starts from `config_file.parent`."""
    return config_file.parent / config.pneumatics.rig if config_file and config.pneumatics.rig else None


def text_of(path: Path) -> str:
    """The text of a configuration file. Raises `ConfigError` if it cannot be read."""
    return read_text(path, ConfigError, f"; `flying-vines config init {path}` writes one")


def parse(text: str, source: str, recorded: bool = False) -> Config:
    """Check the text of a configuration; errors name it as `source`.

    A `recorded` configuration may have what earlier versions allowed: open links, which a replay does not
    open, and a switch on any channel.
    """
    raw = parsed(text, source, ConfigError)
    for *tables, old in (*OLD_SETTINGS, *RENAMED):
        table: Any = raw
        for name in tables:
            table = table.get(name) if isinstance(table, dict) else None
        if isinstance(table, dict) and old in table:
            value, new = table.pop(old), RENAMED.get((*tables, old))
            if new is not None:
                table.setdefault(new, value)
    try:
        inside: Key = ()
        for name, profile in _profiles_of(raw):
            inside = ("profiles", name)
            rest, own = with_own_segments(profile, SEGMENTS)
            msgspec.convert(rest, PressureProfile)
            if own:
                raw["profiles"][name] = put_in(rest, own)
        inside = ()
        config = msgspec.convert(raw, Config)
    except PluginError as error:
        raise ConfigError(located(text, source, inside, str(error))) from None
    except msgspec.ValidationError as error:
        raise _explain(text, source, raw, str(error), inside) from None
    for key, reason in _contradictions(config) or ([] if recorded else _unsafe(config)):
        raise ConfigError(f"{place(text, source, key)}: {dotted(key)}: {reason}")
    return config


OLD_SETTINGS: dict[Key, str] = {
    ("calibration",): "the vine is calibrated on the ground: flying-vines calibrate",
    ("telemetry", "fuel_status"): "FUEL_STATUS is no longer sent, because no ground station shows it",
    (
        "losses",
        "on_autopilot_loss",
    ): "the loss of the autopilot always vents the vine, because the altitude is lost, too",
    ("mqtt", "client_id"): "it is PREFIX-NAME, of mqtt.prefix and mqtt.name",
    ("mqtt", "keepalive_s"): "it is always 30 s",
    ("mqtt", "kept_events"): "1000 events are always stored",
    ("mqtt", "asked_within_s"): "it is always 5 s",
}
"""Settings of earlier versions, which are ignored, and why."""
RENAMED: dict[Key, str] = {
    ("checks", "bottle_loss"): "reservoir_loss",
    ("checks", "bottle_sensor"): "reservoir_sensor",
    ("checks", "bottle_hot"): "reservoir_hot",
}
"""Settings that had another name in earlier versions, and their last names now. Both names are read."""


def renamed(text: str, source: str) -> list[str]:
    """A line for each setting that the text names as earlier versions did."""
    return _remarks(text, source, {key: f"is called {new} now: rename it" for key, new in RENAMED.items()})


def ignored(text: str, source: str, old: Mapping[Key, str]) -> list[str]:
    """A line for each of these settings that the text of a TOML file has."""
    return _remarks(text, source, {key: f"is ignored, delete it: {why}" for key, why in old.items()})


def _remarks(text: str, source: str, remarks: Mapping[Key, str]) -> list[str]:
    present = lines_of_keys(text)
    return [located(text, source, key, remark) for key, remark in remarks.items() if key in present]


def _profiles_of(raw: dict[str, Any]) -> list[tuple[str, Any]]:
    """Names and raw profiles. Each is decoded alone, so that an error names its profile."""
    profiles = raw.get("profiles")
    return list(profiles.items()) if isinstance(profiles, dict) else []


def _contradictions(config: Config) -> list[tuple[Key, str]]:
    """The keys whose values are invalid, alone or together with other values, and the reasons."""
    if invalid := list(_invalid_values(config)):
        return invalid
    try:
        curve = config.vine.bend_curve()
    except ValueError as error:
        return [(("vine", "hysteresis_kPa"), str(error))]
    return [
        *_impossible_profiles(config, curve),
        *_missing_profiles(config),
        *_above_the_limit(config, curve),
    ]


def _invalid_values(config: Config) -> Iterator[tuple[Key, str]]:
    for table, link in (("vehicle", config.vehicle.link), ("firmware", config.firmware.link)):
        try:
            parse_address(link)
        except ValueError as error:
            yield (table, "link"), str(error)
    try:
        ipaddress.ip_address(config.page.host)
    except ValueError:
        reason = f"'{config.page.host}' is not an IP address: give 127.0.0.1, or 0.0.0.0 for all"
        yield ("page", "host"), reason
    for key in not_finite(msgspec.to_builtins(config)):
        yield key, "is not a finite number"
    for name, reason in _broker_contradictions(config.mqtt):
        yield ("mqtt", name), reason


def _impossible_profiles(config: Config, curve: BendCurve) -> Iterator[tuple[Key, str]]:
    """The profiles that cannot be unrolled, exceed the bend curve or the pressure limit, or are too fast."""
    for name, profile in config.profiles.items():
        key = ("profiles", name)
        try:
            segments = tuple(flatten(config.profiles, name))
        except ValueError as error:
            yield key, str(error)
            continue
        for segment in segments:
            for value in (getattr(segment, field, None) for field in ("to_deg", "from_deg")):
                if value is not None and not curve.min_deg <= value <= curve.max_deg:
                    angles = f"{curve.min_deg:g}…{curve.max_deg:g}°"
                    yield key, f"{value:g}° is outside the bend curve's {angles}"
            for value in (getattr(segment, field, None) for field in ("to_kPa", "from_kPa")):
                if value is not None and not 0 <= value <= config.limits.max_kPa:
                    limit = f"0…{config.limits.max_kPa:g} kPa (limits.max_kPa)"
                    yield key, f"{value:g} kPa is outside {limit}"
            if isinstance(segment, Sine) and (reason := _too_fast(config, curve, profile, segment)):
                yield key, reason


def _missing_profiles(config: Config) -> Iterator[tuple[Key, str]]:
    """The names in switch, triggers and items for which there is no profile."""
    for i, name in enumerate(config.switch.positions):
        if name and name not in config.profiles:
            yield ("switch", "positions", i), no_profile(config, name)
    for i, trigger in enumerate(config.triggers):
        if trigger.profile not in config.profiles:
            yield ("triggers", i, "profile"), no_profile(config, trigger.profile)
    for i, item in enumerate(config.items):
        if item.profile is not None and item.profile not in config.profiles:
            yield ("items", i, "profile"), no_profile(config, item.profile)


def _above_the_limit(config: Config, curve: BendCurve) -> Iterator[tuple[Key, str]]:
    if curve.max_kPa > config.limits.max_kPa:
        reason = f"the curve goes to {curve.max_kPa:g} kPa, above limits.max_kPa = {config.limits.max_kPa:g}"
        yield ("vine", "curve"), reason
    if config.pneumatics.cycle_swing_kPa > config.limits.max_kPa:
        yield ("pneumatics", "cycle_swing_kPa"), "is above limits.max_kPa"


def _unsafe(config: Config) -> list[tuple[Key, str]]:
    return [*_open_links(config), *_taken(config), *_without_effect(config)]


def _without_effect(config: Config) -> Iterator[tuple[Key, str]]:
    """What is written and could not do what it says."""
    for key in _PATHS:
        path = getattr(getattr(config, key[0]), key[1])
        if path.startswith("~") or "$" in path:
            yield key, f"'{path}': ~ and $ are not replaced: write the whole path"
    if config.firmware.is_phlosar and config.firmware.settings:
        yield ("firmware", "settings"), "a phloSAR has none: delete them, or set firmware.kind"
    full_kPa, needed_kPa = config.pneumatics.full_kPa, config.limits.max_kPa + config.interlocks.reserve_kPa
    if full_kPa < needed_kPa:
        reason = f"is below limits.max_kPa + interlocks.reserve_kPa = {needed_kPa:g}: a full bend is refused"
        yield ("pneumatics", "full_kPa"), reason
    for name, profile in config.profiles.items():
        for segment in profile.segments:
            if isinstance(segment, Ramp) and segment.over_s > config.limits.max_bent_s:
                reason = f"a ramp of {segment.over_s:g} s is longer than limits.max_bent_s, which ends it"
                yield ("profiles", name), reason


def _taken(config: Config) -> Iterator[tuple[Key, str]]:
    """What two parts of the rig cannot share: a port, a channel of the transmitter."""
    if same_port(parse_address(config.vehicle.link), parse_address(config.firmware.link)):
        yield ("firmware", "link"), "is the port of vehicle.link: the board needs its own"
    if problem := config.switch.channel_problem:
        yield ("switch", "channel"), problem


def _open_links(config: Config) -> list[tuple[Key, str]]:
    """Links over which anybody on the network could command the vine or send false telemetry."""
    found: list[tuple[Key, str]] = []
    for table, link, signed in (
        ("vehicle", config.vehicle.link, bool(config.vehicle.signing_key)),
        ("firmware", config.firmware.link, False),
    ):
        address = parse_address(link)
        if isinstance(address, NetworkAddress) and address.is_open and not signed:
            way = f"name the sender ({link}?peer=ADDRESS)"
            way += ", listen on 127.0.0.1, or set vehicle.signing_key" if table == "vehicle" else ""
            found.append(((table, "link"), f"anybody on the network could command the vine: {way}"))
    return found


def _broker_contradictions(mqtt: MqttConfig) -> list[tuple[str, str]]:
    found = []
    tls = False
    if mqtt.broker:
        try:
            tls = parse_broker(mqtt.broker).tls
        except ValueError as error:
            found.append(("broker", str(error)))
    for key in ("prefix", "discovery_prefix", "name"):
        value = getattr(mqtt, key)
        levels = value.split("/") if "prefix" in key else [value]
        if value and not all(_TOPIC_LEVEL.fullmatch(level) for level in levels):
            found.append((key, f"'{value}' is not a valid topic name: use letters, digits, '-', '_' and '.'"))
    if not mqtt.prefix:
        found.append(("prefix", "is empty: give the first level of the topics"))
    for key in ("password_file", "ca_file", "certificate_file", "key_file"):
        if (file := getattr(mqtt, key)) and not file.startswith("/"):
            found.append((key, f"'{file}': give an absolute path, which begins with /"))
        if file and key != "password_file" and mqtt.broker and not tls:
            found.append((key, "needs TLS: the broker's address must begin with mqtts://"))
    if mqtt.password_file and not mqtt.username:
        found.append(("password_file", "needs a username"))
    if bool(mqtt.certificate_file) != bool(mqtt.key_file):
        found.append(
            (
                "certificate_file" if mqtt.certificate_file else "key_file",
                "set both certificate_file and key_file",
            )
        )
    return found


def _too_fast(config: Config, curve: BendCurve, profile: PressureProfile, sine: Sine) -> str:
    """Why a sine is too fast; empty if it is not."""
    low, high = ends_kPa(sine, curve)
    steepest = math.pi * sine.frequency_Hz * abs(high - low)
    limit = min(profile.rate_kPa_per_s or math.inf, config.limits.max_rate_kPa_per_s)
    if steepest <= limit:
        return ""
    return f"the sine needs {steepest:.0f} kPa/s, the rate limit is {limit:g} kPa/s"


def no_profile(config: Config, name: str) -> str:
    """The error text for a profile that does not exist."""
    near = difflib.get_close_matches(name, config.profiles, n=1)
    return f"there is no profile '{name}'" + (f"; did you mean '{near[0]}'?" if near else "")


def _explain(text: str, source: str, raw: object, error: str, inside: Key) -> ConfigError:
    key, reason = explained(error, Config, inside, raw)
    if key[-1:] == ("kind",) and (own := installed("segments")):
        reason += f"; installed packages have {', '.join(own)}"
    return ConfigError(located(text, source, key, reason))

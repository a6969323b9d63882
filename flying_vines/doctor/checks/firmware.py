"""Checks the phloSAR: is it our firmware and without faults, is the line good, are its readings plausible?"""

from __future__ import annotations

import math

from firmware_link.protocol import Setting, SettingsMemory, Welcome, fault_names
from flying_vines.config.config import Config
from flying_vines.core.safety import FAULT_SENTENCES, needed_kPa
from flying_vines.doctor.checks.machine import excused
from flying_vines.doctor.finding import DoctorFinding, FindingText
from flying_vines.doctor.firmware_probe import FirmwareFacts

MIN_RATE_SHARE = 0.8
"""Telemetry below this share of the firmware's stated rate is slow."""
SLOW_ROUND_TRIP_S = 0.1
MAX_LOST_SHARE = 0.001
BELOW_ZERO_KPA = 15.0
"""Maximum offset of a good 15 bar sensor at ambient pressure."""
ABOVE_FULL = 1.05
FALLS_KPA_PER_S = 0.5
"""Limit of the reservoir's pressure loss with all valves shut."""

NO_PORT = FindingText(
    "phloSAR", "skipped", "not checked, because its port cannot be used: see the result for the port"
)
OTHER = FindingText("phloSAR", "skipped", "not checked: firmware.kind is {kind!r}")
NO_ANSWER = FindingText(
    "phloSAR",
    "bad",
    "{why}",
    "check its power and USB cable; `sudo fuser -v PORT` names other programs that use its port; "
    "`flying-vines link` shows the received bytes (docs/link.md)",
)
GOOD = FindingText("phloSAR", "good", "{build!r} answers, protocol {version}, boot {boot:08x}")
FAULTS = FindingText(
    "phloSAR",
    "bad",
    "latched: {faults}",
    "find the cause; then clear it from a ground station (command USER_5, 1), or switch the board off and on",
)
RESTARTED = FindingText(
    "phloSAR",
    "bad",
    "it restarted {times} times during this check",
    "check its supply and its USB cable",
)
RATE = FindingText(
    "phloSAR line",
    "good",
    "{rate:.0f} telemetry messages a second, round trip {trip:.0f} ms, {frames} frames, {lost} lost",
)
NO_TELEMETRY = FindingText(
    "phloSAR line",
    "bad",
    "it answers, but sends no telemetry",
    "flash its firmware again, or try another cable",
)
SLOW = FindingText(
    "phloSAR line",
    "warning",
    "{rate:.0f} telemetry messages a second, not {wanted}",
    "check the load of this computer, and the serial line's baud rate (at least 57600)",
)
LOSSES = FindingText(
    "phloSAR line",
    "warning",
    "{lost} of {frames} frames lost or corrupt, {gaps} gaps in telemetry",
    "use a shorter, shielded cable, away from motor wires",
)
FAR = FindingText(
    "phloSAR line",
    "warning",
    "a round trip takes {trip:.0f} ms",
    "check the load of this computer; with a serial server, also the network",
)
SETTINGS = FindingText("phloSAR settings", "good", "all {count} have their defaults")
OWN_SETTINGS = FindingText("phloSAR settings", "good", "{count}; not at their default: {changed}")
SOME_SETTINGS = FindingText(
    "phloSAR settings",
    "warning",
    "{read} of {count} settings read in the time",
    "repeat with a longer --seconds, on a computer that does nothing else",
)
NO_SETTINGS = FindingText("phloSAR settings", "warning", "{why}", "try again; then flash the firmware again")
KNOWN_SETTINGS = FindingText("phloSAR memory", "good", "the settings of the last flight")
NEW_SETTINGS = FindingText(
    "phloSAR memory", "good", "the settings are stored; the service remembers them when it starts"
)
OTHER_SETTINGS = FindingText(
    "phloSAR memory",
    "bad",
    "the settings are not those of the last flight",
    "compare them with the rig (flying-vines link --settings); then start the service, and clear faults",
)
ERASED_SETTINGS = FindingText(
    "phloSAR memory",
    "bad",
    "erased: the standard settings are used",
    "set and store the rig's: flying-vines link --set; then start the service, and clear faults",
)
DAMAGED_SETTINGS = FindingText(
    "phloSAR memory",
    "bad",
    "damaged: the standard settings are used",
    "set and store the rig's: flying-vines link --set; then start the service, and clear faults",
)
LIMITS = FindingText(
    "phloSAR limits", "good", "setpoints up to {most:g}, vine {vine:g}, bottle {bottle:g} kPa; {rate:g} kPa/s"
)
LOW_SETPOINTS = FindingText(
    "phloSAR limits",
    "bad",
    "it accepts setpoints up to {most:g} kPa; the configuration uses up to {wanted:g} (limits.max_kPa)",
    "lower limits.max_kPa, or raise the firmware's limit: flying-vines link --set cv_limit_kPa={raised:g}",
)
VENTS_FIRST = FindingText(
    "phloSAR limits",
    "warning",
    "it vents at {vine:g} kPa, before limits.overpressure_kPa = {over:g} is reached",
    "set limits.overpressure_kPa below it, so that the pilot reads why the vine is vented",
)
LOW_BOTTLE = FindingText(
    "phloSAR limits",
    "bad",
    "it vents with the bottle above {bottle:g} kPa; a full bottle has {full:g} (pneumatics.full_kPa)",
    "fill it less and lower pneumatics.full_kPa; raise reservoir_limit_kPa only if the bottle allows it",
)
LOW_RATE = FindingText(
    "phloSAR limits",
    "warning",
    "its maximum rate is {rate:g} kPa/s; the configuration allows {wanted:g} (limits.max_rate_kPa_per_s)",
    "lower limits.max_rate_kPa_per_s; otherwise fast motions end later than planned",
)
VINE = FindingText("vine sensor", "good", "{kPa:z.2f} kPa at rest")
VINE_OFF = FindingText(
    "vine sensor",
    "bad",
    "{kPa:.1f} kPa in a vented vine; a good sensor is within ±{zero:g}",
    "check that the outlet is free; then set the zero: flying-vines link --set cv_zero_kPa=…",
)
BOTTLE = FindingText(
    "bottle", "good", "{kPa:.0f} kPa, enough for {cycles:.0f} cycles ({low:.0f} … {high:.0f})"
)
BOTTLE_EMPTY = FindingText(
    "bottle",
    "bad",
    "{kPa:.0f} kPa; a bend to {most:g} kPa needs {needed:.0f}",
    "fill the bottle, and open its valve",
)
BOTTLE_LOW = FindingText(
    "bottle", "warning", "{kPa:.0f} kPa, enough for {cycles:.0f} cycles ({low:.0f} … {high:.0f})", "fill it"
)
BOTTLE_SENSOR = FindingText(
    "bottle",
    "bad",
    "its sensor reads {kPa:.0f} kPa, which is impossible",
    "check the sensor and its wire; `flying-vines link --settings` shows its span and zero",
)
BOTTLE_OVER = FindingText(
    "bottle",
    "warning",
    "{kPa:.0f} kPa, more than a full bottle has ({full:g}, pneumatics.full_kPa)",
    "let air out, or correct pneumatics.full_kPa",
)
BOTTLE_LOSES = FindingText(
    "bottle",
    "bad",
    "the bottle loses {rate:.1f} kPa/s with all valves shut",
    "find the leak with soapy water on hoses, fittings and the Venturi",
)


def check(
    facts: FirmwareFacts | None, config: Config, board_settings: int | None = None, late_s: float = 0.0
) -> list[DoctorFinding]:
    """`facts` is None if the port could not be opened; `board_settings` is the digest that is known.

    `late_s` is the lateness of our own loop.
    """
    if not config.firmware.is_phlosar:
        return [OTHER(kind=config.firmware.kind)]
    if facts is None:
        return [NO_PORT()]
    if facts.welcome is None:
        return [NO_ANSWER(why=facts.port)]
    welcome = facts.welcome
    found = [GOOD(build=welcome.firmware_build, version=welcome.protocol_version, boot=welcome.boot_id)]
    if facts.faults:
        sentences = [text for fault, text in FAULT_SENTENCES.items() if fault in facts.faults]
        found.append(FAULTS(faults=", ".join(sentences) or fault_names(facts.faults)))
    if facts.restarts:
        found.append(RESTARTED(times=facts.restarts))
    found += [excused(line, late_s) for line in _line(facts, welcome)]
    if facts.settings_problem:
        found.append(NO_SETTINGS(why=facts.settings_problem))
    elif facts.settings:
        found.append(_settings(facts.settings))
    found.append(_memory(welcome, board_settings))
    found += _limits(welcome, config)
    if facts.telemetry_Hz > 0.0:
        found += [_vine(facts, config), *_bottle(facts, config)]
    return found


def _line(facts: FirmwareFacts, welcome: Welcome) -> list[DoctorFinding]:
    if facts.telemetry_Hz == 0.0:
        return [NO_TELEMETRY()]
    found = []
    trip_ms = 1e3 * (facts.round_trip_s or 0.0)
    if facts.telemetry_Hz < MIN_RATE_SHARE * welcome.telemetry_Hz:
        found.append(SLOW(rate=facts.telemetry_Hz, wanted=welcome.telemetry_Hz))
    frames = facts.good_frames + facts.bad_frames
    if max(facts.bad_frames, facts.gaps) > MAX_LOST_SHARE * frames:
        found.append(LOSSES(lost=facts.bad_frames, frames=frames, gaps=facts.gaps))
    if trip_ms > 1e3 * SLOW_ROUND_TRIP_S:
        found.append(FAR(trip=trip_ms))
    return found or [RATE(rate=facts.telemetry_Hz, trip=trip_ms, frames=frames, lost=facts.bad_frames)]


def _settings(settings: tuple[Setting, ...]) -> DoctorFinding:
    if len(settings) < settings[0].count:
        return SOME_SETTINGS(read=len(settings), count=settings[0].count)
    changed = [f"{s.name} = {s.value:.5g}" for s in settings if s.value != s.standard]
    if changed:
        return OWN_SETTINGS(count=len(settings), changed=", ".join(changed))
    return SETTINGS(count=len(settings))


def _memory(welcome: Welcome, known: int | None) -> DoctorFinding:
    """By the rules of the core's `board_settings`."""
    if welcome.settings_memory is SettingsMemory.DAMAGED:
        return DAMAGED_SETTINGS()
    if welcome.settings_digest == known:
        return KNOWN_SETTINGS()
    if welcome.settings_memory is SettingsMemory.ERASED:
        return ERASED_SETTINGS()
    return OTHER_SETTINGS() if known is not None else NEW_SETTINGS()


def _limits(welcome: Welcome, config: Config) -> list[DoctorFinding]:
    limits, full_kPa = config.limits, config.pneumatics.full_kPa
    found = []
    if welcome.setpoint_limit_kPa < limits.max_kPa:
        margin_kPa = welcome.cv_limit_kPa - welcome.setpoint_limit_kPa
        raised = math.ceil(limits.max_kPa + margin_kPa)
        found.append(LOW_SETPOINTS(most=welcome.setpoint_limit_kPa, wanted=limits.max_kPa, raised=raised))
    elif welcome.cv_limit_kPa < limits.overpressure_kPa:
        found.append(VENTS_FIRST(vine=welcome.cv_limit_kPa, over=limits.overpressure_kPa))
    if welcome.reservoir_limit_kPa < full_kPa:
        found.append(LOW_BOTTLE(bottle=welcome.reservoir_limit_kPa, full=full_kPa))
    if welcome.rate_limit_kPa_per_s < limits.max_rate_kPa_per_s:
        found.append(LOW_RATE(rate=welcome.rate_limit_kPa_per_s, wanted=limits.max_rate_kPa_per_s))
    if not found:
        found.append(
            LIMITS(
                most=welcome.setpoint_limit_kPa,
                vine=welcome.cv_limit_kPa,
                bottle=welcome.reservoir_limit_kPa,
                rate=welcome.rate_limit_kPa_per_s,
            )
        )
    return found


def _vine(facts: FirmwareFacts, config: Config) -> DoctorFinding:
    zero_kPa = config.checks.zero_kPa
    # NaN must not count as good.
    if abs(facts.cv_kPa) <= zero_kPa:
        return VINE(kPa=facts.cv_kPa)
    return VINE_OFF(kPa=facts.cv_kPa, zero=zero_kPa)


def _bottle(facts: FirmwareFacts, config: Config) -> list[DoctorFinding]:
    kPa, full_kPa, most_kPa = facts.reservoir_kPa, config.pneumatics.full_kPa, config.limits.max_kPa
    least_kPa = needed_kPa(most_kPa, facts.full_bend_spends_kPa, config.interlocks)
    if not kPa >= -BELOW_ZERO_KPA:
        return [BOTTLE_SENSOR(kPa=kPa)]
    if kPa < least_kPa:
        return [BOTTLE_EMPTY(kPa=kPa, most=most_kPa, needed=least_kPa)]
    found = []
    if facts.reservoir_falls_kPa_per_s > FALLS_KPA_PER_S:
        found.append(BOTTLE_LOSES(rate=facts.reservoir_falls_kPa_per_s))
    left = facts.cycles_left
    if kPa > ABOVE_FULL * full_kPa:
        found.append(BOTTLE_OVER(kPa=kPa, full=full_kPa))
    elif left is not None:
        low = left.expected < config.telemetry.low_reservoir_cycles
        found.append(
            (BOTTLE_LOW if low else BOTTLE)(kPa=kPa, cycles=left.expected, low=left.low, high=left.high)
        )
    return found

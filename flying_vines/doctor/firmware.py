"""The phloSAR at rest: is it our firmware and without faults, is the line good, are its readings plausible?

The probe sends only Hello, Ping and GetSetting, by `firmware_link.monitor`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import fmean

from firmware_link.host import SessionState
from firmware_link.monitor import SeenFrame
from firmware_link.protocol import Fault, Setting, SettingsMemory, Telemetry, Welcome, fault_names
from firmware_link.settings import SettingsExchange
from flying_vines.config.address import Address
from flying_vines.config.config import Config
from flying_vines.core.safety import FAULT_SENTENCES, needed_kPa
from flying_vines.doctor.computer import excused
from flying_vines.doctor.finding import DoctorFinding, Subject
from flying_vines.service.link_watch import LinkEvent, LinkWatch
from flying_vines.supply import CyclesLeft, ReservoirEstimate, RigPrior, TelemetryReader
from flying_vines.supply.cycles_left import Learned

REST_S = 1.0
"""Readings are averaged over this time, at the start and at the end. Hello has vented the vine."""


@dataclass(frozen=True, slots=True)
class FirmwareFacts:
    """Facts from the phloSAR's line. Pressures are gauge."""

    port: str = ""
    """The state of the port and of its device: a sentence."""
    welcome: Welcome | None = None
    """None if no firmware of our version answered."""
    settings: tuple[Setting, ...] = ()
    settings_problem: str = ""
    telemetry_Hz: float = 0.0
    gaps: int = 0
    bad_frames: int = 0
    """Damaged, lost or unknown frames since the firmware answered."""
    good_frames: int = 0
    round_trip_s: float | None = None
    restarts: int = 0
    faults: Fault = Fault.NONE
    cv_kPa: float = math.nan
    reservoir_kPa: float = math.nan
    reservoir_falls_kPa_per_s: float = 0.0
    cycles_left: CyclesLeft | None = None
    full_bend_spends_kPa: float = 0.0
    """The reservoir's expected fall by a bend to `limits.max_kPa`."""


class FirmwareProbe:
    """Listens and sends requests at `address` while `run` runs.

    `full_bend_kPa` is the pressure of the largest bend, gauge; `learned` has the air of earlier flights.
    """

    def __init__(
        self, address: Address, prior: RigPrior, full_bend_kPa: float, learned: Learned | None = None
    ) -> None:
        self._full_bend_kPa = full_bend_kPa
        self._settings_exchange = SettingsExchange()
        self._watch = LinkWatch(address, self._settings_exchange)
        self._reader = TelemetryReader(prior)
        self._reservoir = ReservoirEstimate(prior, learned)
        self._readings: list[tuple[float, Telemetry]] = []
        self._boots: set[int] = set()

    async def run(self, over: Callable[[], bool]) -> None:
        await self._watch.run(self._take, over)

    def _take(self, events: Sequence[LinkEvent]) -> None:
        for seen in events:
            if not isinstance(seen, SeenFrame) or seen.sent:
                continue
            if isinstance(seen.message, Welcome):
                self._boots.add(seen.message.boot_id)
            elif isinstance(seen.message, Telemetry) and self._watch.answered:
                self._readings.append((seen.t, seen.message))
                self._reservoir.update(self._reader.read(seen.t, seen.message))

    @property
    def facts(self) -> FirmwareFacts:
        watch, session = self._watch, self._watch.monitor.session
        if session.state is not SessionState.READY:
            why = "the board stopped answering" if watch.answered else "the board does not answer"
            return FirmwareFacts(port=f"{watch.port.text}, but {why}" if watch.port.good else watch.port.text)
        now, before = watch.statistics, watch.clean_since or watch.statistics
        bad = (now.bad_frames - before.bad_frames, now.lost_frames - before.lost_frames)
        facts = FirmwareFacts(
            port=watch.port.text,
            welcome=session.welcome,
            settings=tuple(self._settings_exchange.settings),
            settings_problem=self._settings_exchange.problem,
            gaps=now.telemetry_gaps - before.telemetry_gaps,
            # A corrupt frame also leaves a gap in the sequence numbers and so counts as lost.
            bad_frames=max(bad) + now.unknown_messages - before.unknown_messages,
            good_frames=now.good_frames - before.good_frames,
            round_trip_s=session.round_trip_s,
            restarts=max(0, len(self._boots) - 1),
            full_bend_spends_kPa=self._reservoir.spending_kPa(self._full_bend_kPa),
        )
        return with_readings(facts, self._readings, self._reservoir.cycles_left())


def with_readings(
    facts: FirmwareFacts, readings: Sequence[tuple[float, Telemetry]], left: CyclesLeft | None
) -> FirmwareFacts:
    """The facts with rates and pressures from `readings`: (time, telemetry)."""
    if len(readings) < 2:
        return facts
    began_s, ended_s = readings[0][0], readings[-1][0]
    first = [telemetry.reservoir_kPa for t, telemetry in readings if t <= began_s + REST_S]
    last = [telemetry for t, telemetry in readings if t >= ended_s - REST_S]
    reservoir_kPa = fmean(telemetry.reservoir_kPa for telemetry in last)
    apart_s = ended_s - began_s - REST_S
    return replace(
        facts,
        telemetry_Hz=(len(readings) - 1) / max(1e-6, ended_s - began_s),
        faults=readings[-1][1].faults,
        cv_kPa=fmean(telemetry.cv_kPa for telemetry in last),
        reservoir_kPa=reservoir_kPa,
        # The averaged intervals at both ends must not overlap.
        reservoir_falls_kPa_per_s=(fmean(first) - reservoir_kPa) / apart_s if apart_s > REST_S else 0.0,
        cycles_left=left,
    )


MIN_RATE_SHARE = 0.8
"""Telemetry below this share of the firmware's stated rate is slow."""
SLOW_ROUND_TRIP_S = 0.1
MAX_LOST_SHARE = 0.001
BELOW_ZERO_KPA = 15.0
"""Maximum offset of a good 15 bar sensor at ambient pressure."""
ABOVE_FULL = 1.05
FALLS_KPA_PER_S = 0.5
"""Limit of the reservoir's pressure loss with all valves shut."""

_PHLOSAR = Subject("phloSAR")
NO_PORT = _PHLOSAR.skipped("not checked, because its port cannot be used: see the result for the port")
OTHER = _PHLOSAR.skipped("not checked: firmware.kind is {kind!r}")
NO_ANSWER = _PHLOSAR.bad(
    "{why}",
    "check its power and USB cable; `sudo fuser -v PORT` names other programs that use its port; "
    "`flying-vines link` shows the received bytes (docs/link.md)",
)
GOOD = _PHLOSAR.good("{build!r} answers, protocol {version}, boot {boot:08x}")
FAULTS = _PHLOSAR.bad(
    "latched: {faults}",
    "find the cause; then clear it from a ground station (command USER_5, 1), or switch the board off and on",
)
RESTARTED = _PHLOSAR.bad("it restarted {times} times during this check", "check its supply and its USB cable")
_PHLOSAR_LINE = Subject("phloSAR line")
RATE = _PHLOSAR_LINE.good(
    "{rate:.0f} telemetry messages a second, round trip {trip:.0f} ms, {frames} frames, {lost} lost"
)
NO_TELEMETRY = _PHLOSAR_LINE.bad(
    "it answers, but sends no telemetry", "flash its firmware again, or try another cable"
)
SLOW = _PHLOSAR_LINE.warning(
    "{rate:.0f} telemetry messages a second, not {wanted}",
    "check the load of this computer, and the serial line's baud rate (at least 57600)",
)
LOSSES = _PHLOSAR_LINE.warning(
    "{lost} of {frames} frames lost or corrupt, {gaps} gaps in telemetry",
    "use a shorter, shielded cable, away from motor wires",
)
FAR = _PHLOSAR_LINE.warning(
    "a round trip takes {trip:.0f} ms",
    "check the load of this computer; with a serial server, also the network",
)
_PHLOSAR_SETTINGS = Subject("phloSAR settings")
SETTINGS = _PHLOSAR_SETTINGS.good("all {count} have their defaults")
OWN_SETTINGS = _PHLOSAR_SETTINGS.good("{count}; not at their default: {changed}")
SOME_SETTINGS = _PHLOSAR_SETTINGS.warning(
    "{read} of {count} settings read in the time",
    "repeat with a longer --seconds, on a computer that does nothing else",
)
NO_SETTINGS = _PHLOSAR_SETTINGS.warning("{why}", "try again; then flash the firmware again")
_PHLOSAR_MEMORY = Subject("phloSAR memory")
KNOWN_SETTINGS = _PHLOSAR_MEMORY.good("the settings of the last flight")
NEW_SETTINGS = _PHLOSAR_MEMORY.good("the settings are stored; the service remembers them when it starts")
OTHER_SETTINGS = _PHLOSAR_MEMORY.bad(
    "the settings are not those of the last flight",
    "compare them with the rig (flying-vines link --settings); then start the service, and clear faults",
)
ERASED_SETTINGS = _PHLOSAR_MEMORY.bad(
    "erased: the standard settings are used",
    "set and store the rig's: flying-vines link --set; then start the service, and clear faults",
)
DAMAGED_SETTINGS = _PHLOSAR_MEMORY.bad(
    "damaged: the standard settings are used",
    "set and store the rig's: flying-vines link --set; then start the service, and clear faults",
)
_PHLOSAR_LIMITS = Subject("phloSAR limits")
LIMITS = _PHLOSAR_LIMITS.good(
    "setpoints up to {setpoint_limit_kPa:g}, vine {cv_limit_kPa:g}, reservoir {reservoir_limit_kPa:g} kPa; "
    "{rate_limit_kPa_per_s:g} kPa/s"
)
LOW_SETPOINTS = _PHLOSAR_LIMITS.bad(
    "it accepts setpoints up to {setpoint_limit_kPa:g} kPa; the configuration uses up to {wanted:g} "
    "(limits.max_kPa)",
    "lower limits.max_kPa, or raise the firmware's limit: flying-vines link --set cv_limit_kPa={raised:g}",
)
VENTS_FIRST = _PHLOSAR_LIMITS.warning(
    "it vents at {cv_limit_kPa:g} kPa, before limits.overpressure_kPa = {over:g} is reached",
    "set limits.overpressure_kPa below it, so that the pilot reads why the vine is vented",
)
LOW_RESERVOIR = _PHLOSAR_LIMITS.bad(
    "it vents with the reservoir above {reservoir_limit_kPa:g} kPa; a full reservoir has {full:g} "
    "(pneumatics.full_kPa)",
    "fill it less and lower pneumatics.full_kPa; raise reservoir_limit_kPa only if the reservoir allows it",
)
LOW_RATE = _PHLOSAR_LIMITS.warning(
    "its maximum rate is {rate_limit_kPa_per_s:g} kPa/s; the configuration allows {wanted:g} "
    "(limits.max_rate_kPa_per_s)",
    "lower limits.max_rate_kPa_per_s; otherwise fast motions end later than planned",
)
_VINE_SENSOR = Subject("vine sensor")
VINE = _VINE_SENSOR.good("{kPa:z.2f} kPa at rest")
VINE_OFF = _VINE_SENSOR.bad(
    "{kPa:.1f} kPa in a vented vine; a good sensor is within ±{zero:g}",
    "check that the outlet is free; then set the zero: flying-vines link --set cv_zero_kPa=…",
)
_RESERVOIR = Subject("reservoir")
RESERVOIR = _RESERVOIR.good("{kPa:.0f} kPa, enough for {cycles:.0f} cycles ({low:.0f} … {high:.0f})")
RESERVOIR_EMPTY = _RESERVOIR.bad(
    "{kPa:.0f} kPa; a bend to {most:g} kPa needs {needed:.0f}", "fill the reservoir, and open its valve"
)
RESERVOIR_LOW = _RESERVOIR.warning(
    "{kPa:.0f} kPa, enough for {cycles:.0f} cycles ({low:.0f} … {high:.0f})", "fill it"
)
RESERVOIR_SENSOR = _RESERVOIR.bad(
    "its sensor reads {kPa:.0f} kPa, which is impossible",
    "check the sensor and its wire; `flying-vines link --settings` shows its span and zero",
)
RESERVOIR_OVER = _RESERVOIR.warning(
    "{kPa:.0f} kPa, more than a full reservoir has ({full:g}, pneumatics.full_kPa)",
    "let air out, or correct pneumatics.full_kPa",
)
RESERVOIR_LOSES = _RESERVOIR.bad(
    "the reservoir loses {rate:.1f} kPa/s with all valves shut",
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
        found += [_vine(facts, config), *_reservoir(facts, config)]
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
    limits, full_kPa, allowed = config.limits, config.pneumatics.full_kPa, asdict(welcome)
    found = []
    if welcome.setpoint_limit_kPa < limits.max_kPa:
        margin_kPa = welcome.cv_limit_kPa - welcome.setpoint_limit_kPa
        raised = math.ceil(limits.max_kPa + margin_kPa)
        found.append(LOW_SETPOINTS(wanted=limits.max_kPa, raised=raised, **allowed))
    elif welcome.cv_limit_kPa < limits.overpressure_kPa:
        found.append(VENTS_FIRST(over=limits.overpressure_kPa, **allowed))
    if welcome.reservoir_limit_kPa < full_kPa:
        found.append(LOW_RESERVOIR(full=full_kPa, **allowed))
    if welcome.rate_limit_kPa_per_s < limits.max_rate_kPa_per_s:
        found.append(LOW_RATE(wanted=limits.max_rate_kPa_per_s, **allowed))
    return found or [LIMITS(**allowed)]


def _vine(facts: FirmwareFacts, config: Config) -> DoctorFinding:
    zero_kPa = config.checks.zero_kPa
    # NaN must not count as good.
    if abs(facts.cv_kPa) <= zero_kPa:
        return VINE(kPa=facts.cv_kPa)
    return VINE_OFF(kPa=facts.cv_kPa, zero=zero_kPa)


def _reservoir(facts: FirmwareFacts, config: Config) -> list[DoctorFinding]:
    kPa, full_kPa, most_kPa = facts.reservoir_kPa, config.pneumatics.full_kPa, config.limits.max_kPa
    least_kPa = needed_kPa(most_kPa, facts.full_bend_spends_kPa, config.interlocks)
    if not kPa >= -BELOW_ZERO_KPA:
        return [RESERVOIR_SENSOR(kPa=kPa)]
    if kPa < least_kPa:
        return [RESERVOIR_EMPTY(kPa=kPa, most=most_kPa, needed=least_kPa)]
    found = []
    if facts.reservoir_falls_kPa_per_s > FALLS_KPA_PER_S:
        found.append(RESERVOIR_LOSES(rate=facts.reservoir_falls_kPa_per_s))
    left = facts.cycles_left
    if kPa > ABOVE_FULL * full_kPa:
        found.append(RESERVOIR_OVER(kPa=kPa, full=full_kPa))
    elif left is not None:
        low = left.expected < config.telemetry.low_reservoir_cycles
        found.append(
            (RESERVOIR_LOW if low else RESERVOIR)(kPa=kPa, cycles=left.expected, low=left.low, high=left.high)
        )
    return found

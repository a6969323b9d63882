"""Reads from a phloSAR at rest: firmware, settings, sensor readings, and the line's quality.

It sends only Hello, Ping and GetSetting, by `firmware_link.monitor`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import fmean

from firmware_link.host import SessionState
from firmware_link.monitor import SeenFrame
from firmware_link.protocol import Fault, Setting, Telemetry, Welcome
from firmware_link.settings import SettingsExchange
from flying_vines.config.address import Address
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

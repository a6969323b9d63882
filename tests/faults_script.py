"""A random flight from one integer: the setup, the requests, and the faults."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import NamedTuple

from faults_flight import ACTUATOR, LIMIT, PULSES_US, SCRIPT_MESSAGE, SWITCH, MonitoredFlight, Setup
from invariant_monitor import Violation
from random_mishaps import draw_mishap

from flying_vines.simulation.autopilot.rc_input import LOSSES, RcLoss, RcSource
from flying_vines.simulation.phlosar.mishaps import Hole, StuckAt
from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem

TAKE_OFF_S = 1.5
IN_THE_AIR_S = 4.5
NORTH_DEG_PER_M = 1 / 111_319
HARDWARE_SHARE = 0.35
"""Share of hardware faults. The others are faults of vehicle, radio, companion and line."""
TOLD_S = 5.0
BENT_KPA = 2.0
_NO_NEWS = ("refused", "phloSAR ready", "serving vehicle", "limited")


class Act(NamedTuple):
    """A method of `MonitoredFlight`, and its arguments."""

    verb: str
    args: tuple[object, ...] = ()

    def on(self, flight: MonitoredFlight) -> None:
        getattr(flight, self.verb)(*self.args)

    def __str__(self) -> str:
        return f"{self.verb}({', '.join(map(repr, self.args))})"


class Fault(NamedTuple):
    """A fault and its end. Without `end`, the fault remains or ends by itself."""

    name: str
    begins_s: float
    begin: Act
    ends_s: float | None = None
    end: Act | None = None

    def __str__(self) -> str:
        until = "" if self.ends_s is None else f", until {self.ends_s:.3f} s"
        return f"{self.begins_s:.3f} s: {self.begin}{until}"


@dataclass(frozen=True)
class Script:
    seed: int
    setup: Setup
    lasts_s: float
    acts: tuple[tuple[float, Act], ...]
    faults: tuple[Fault, ...]


class Outcome(NamedTuple):
    """The result of a flight."""

    seed: int
    faults: tuple[str, ...]
    bent: tuple[bool, ...]
    """For each fault: true if the vine was under pressure when the fault began."""
    texts: tuple[str, ...]
    """For each fault: the first text that the pilot read within `TOLD_S`, or an empty text."""
    violations: tuple[Violation, ...]
    begins: int
    limits: int
    """Number of motions whose trigger the service cannot distinguish from the pilot's move."""
    highest_kPa: float
    longest_blind_s: float
    timeline: tuple[tuple[float, str], ...]


def draw(seed: int) -> Script:
    """The script of a seed. It is complete before the flight begins."""
    random = Random(seed)
    kind: AutopilotKind = random.choice(("ardupilot", "px4"))
    style = random.choices(("switch", "station", "mission"), (0.5, 0.15, 0.35))[0]
    receivers: tuple[RcSource, ...] = ("sbus", "sbus", "crsf", "overrides")
    lasts_s = round(random.uniform(11.0, 17.0), 1)
    setup = Setup(
        autopilot=kind,
        has_rc=style == "switch" or random.random() < 0.7,
        holds=random.random() < 0.25,
        receiver=random.choice(receivers) if kind == "px4" else None,
        rc_failsafe_mode=random.choice((None, None, None, "RTL", "LAND")) if kind == "ardupilot" else None,
        parameters=random.choice(_HIDING) if kind == "ardupilot" and random.random() < 0.15 else {},
        armed_at_start=random.random() < 0.9,
        max_bent_s=random.choice((120.0, 120.0, 120.0, 6.0)),
        mission=_mission(kind, random) if style == "mission" else (),
        likely_rig=random.random() < 0.05,
        seed=seed,
    )
    acts = _acts(random, style, setup, lasts_s)
    bends_s = [t for t, act in acts if _bends(act) and t > IN_THE_AIR_S]
    faults = [_fault(random, setup, _when(random, bends_s, lasts_s), lasts_s)]
    if random.random() < 0.5:
        while len(faults) < 2:
            near = random.random() < 0.5
            first_s = faults[0].begins_s
            when_s = first_s + random.uniform(0.0, 1.5) if near else _when(random, bends_s, lasts_s)
            second = _fault(random, setup, min(when_s, lasts_s - 1.0), lasts_s)
            if second.begin.verb != faults[0].begin.verb or second.begin.args[:1] != faults[0].begin.args[:1]:
                faults.append(second)
    for fault in faults:
        acts += _around_a_loss(random, setup, fault)
    return Script(seed, setup, lasts_s, tuple(sorted(acts, key=lambda act: act[0])), tuple(faults))


_HIDING: tuple[dict[str, float], ...] = ({"FS_THR_ENABLE": 0.0}, {"RC_FS_TIMEOUT": 8.0}, {"RC_OPTIONS": 36.0})


def _around_a_loss(random: Random, setup: Setup, fault: Fault) -> list[tuple[float, Act]]:
    """The pilot moves the switch during a loss, just before it, or just after it; PX4 may report other
    news."""
    if fault.name not in ("RC lost", "RC blip") or fault.ends_s is None:
        return []
    acts: list[tuple[float, Act]] = []
    if random.random() < 0.5:
        moments = random.uniform(fault.begins_s, fault.ends_s), fault.ends_s, fault.begins_s
        moved_s = max(0.0, random.choice(moments) + random.uniform(-0.1, 0.3))
        acts.append((round(moved_s, 3), Act("move_switch", (random.randrange(3),))))
    if setup.has_real_receiver and random.random() < 0.02:
        acts.append((round(max(0.0, fault.begins_s - random.uniform(0.0, 1.0)), 3), Act("report_health")))
    return acts


def fly(script: Script) -> Outcome:
    """Fly the script to its end."""
    flight = MonitoredFlight(script.setup)
    events: list[tuple[float, int, str, Act]] = [(t, -1, "", act) for t, act in script.acts]
    for number, fault in enumerate(script.faults):
        events.append((fault.begins_s, number, f"FAULT {number + 1} begins: ", fault.begin))
        if fault.end is not None and fault.ends_s is not None:
            events.append((fault.ends_s, -1, f"FAULT {number + 1} ends: ", fault.end))
    events.sort(key=lambda event: event[0])
    bent, began_s = [False] * len(script.faults), [0.0] * len(script.faults)
    for t, number, label, act in events:
        flight.run(max(0.0, t - flight.now_s))
        if number >= 0:
            bent[number], began_s[number] = flight.phlosar.cv_kPa > BENT_KPA, flight.now_s
        flight.note(label + str(act))
        act.on(flight)
    flight.run(max(0.0, script.lasts_s - flight.now_s))
    return Outcome(
        script.seed,
        tuple(fault.name for fault in script.faults),
        tuple(bent),
        tuple(_first_text(flight, t) for t in began_s),
        tuple(flight.violations),
        len(flight.monitor.begins),
        sum(what.startswith(LIMIT) for _, what in flight.monitor.begins),
        flight.monitor.highest_kPa,
        flight.monitor.longest_blind_s,
        tuple(flight.timeline),
    )


def _first_text(flight: MonitoredFlight, since_s: float) -> str:
    for t, text in flight.texts:
        if since_s <= t <= since_s + TOLD_S and not any(words in text for words in _NO_NEWS):
            return text.removeprefix("Vine: ")
    return ""


def _mission(kind: AutopilotKind, random: Random) -> tuple[MissionItem, ...]:
    """Take off, and fly short legs with one or two vine items before each."""
    items = [] if kind == "px4" else [_item(0, 16)]
    items.append(_item(len(items), 22, z=8.0))
    for _ in range(random.randint(2, 4)):
        for _ in range(random.choice((1, 1, 2))):
            items.append(_vine_item(kind, random, len(items)))
        latitude, longitude = (47.397742, 8.545594) if kind == "px4" else (-35.363262, 149.165237)
        north_deg = random.uniform(4.0, 12.0) * len(items) * NORTH_DEG_PER_M
        items.append(_item(len(items), 16, x=latitude + north_deg, y=longitude, z=8.0))
    items.append(_item(len(items), 21))
    return tuple(items)


def _vine_item(kind: AutopilotKind, random: Random, seq: int) -> MissionItem:
    codes = ((0, 0), (1, 40), (1, 15), (2, 0), (3, 0), (4, 0), (5, 0))
    code, angle_deg = random.choice(codes)
    if kind == "px4":
        return _item(seq, ACTUATOR, code, angle_deg, z=1.0)
    return _item(seq, SCRIPT_MESSAGE, code, angle_deg)


def _other_numbers(
    mission: tuple[MissionItem, ...], kind: AutopilotKind, random: Random
) -> tuple[MissionItem, ...]:
    """A mission of the same length with other vine items."""
    own = (ACTUATOR, SCRIPT_MESSAGE)
    return tuple(_vine_item(kind, random, item.seq) if item.command in own else item for item in mission)


def _item(
    seq: int,
    command: int,
    p1: float = 0.0,
    p2: float = 0.0,
    *,
    x: float = 0.0,
    y: float = 0.0,
    z: float = 0.0,
) -> MissionItem:
    frame = 2 if command in (ACTUATOR, SCRIPT_MESSAGE) else 3
    return MissionItem(seq, command, (p1, p2, 0.0, 0.0, x, y, z), frame)


def _acts(random: Random, style: str, setup: Setup, lasts_s: float) -> list[tuple[float, Act]]:
    acts = [(TAKE_OFF_S, Act("start_mission" if style == "mission" else "take_off"))]
    if style == "mission" and random.random() < 0.4:
        # The mission is flown later, and replaced just before.
        starts_s = random.uniform(4.0, 7.0)
        replaced_s = starts_s - random.choice((0.05, 0.15, 0.3, 1.0, 2.5)) - 0.12
        acts = [
            (TAKE_OFF_S, Act("take_off")),
            (
                round(replaced_s, 3),
                Act("replace_mission", (_other_numbers(setup.mission, setup.autopilot, random),)),
            ),
            (round(starts_s, 3), Act("start_mission")),
        ]
    if not setup.armed_at_start:
        acts.append((round(random.uniform(1.0, 7.0), 3), Act("arm_pneumatics")))
    t = random.uniform(1.0, IN_THE_AIR_S + 2.0)
    longest_s = 2.5 if style != "mission" else 8.0
    position = 0
    while t < lasts_s:
        act = _act(random)
        if style == "switch" and random.random() < 0.85:
            position = random.choice([other for other in range(3) if other != position])
            act = Act("move_switch", (position,))
        acts.append((round(t, 3), act))
        t += random.uniform(0.1, longest_s)
    return acts


def _act(random: Random) -> Act:
    chance = random.random()
    if chance < 0.45:
        return Act("press", random.choice(((0, 0.0), (1, 45.0), (1, 20.0), (2, 0.0), (3, 0.0), (5, 0.0))))
    if chance < 0.75:
        return Act("bend_to", (round(random.uniform(5.0, 60.0), 1),))
    return Act(random.choices(list(_RARELY), list(_RARELY.values()))[0])


_RARELY = {
    "vent": 5,
    "clear_faults": 5,
    "hold": 3,
    "disarm_pneumatics": 1,
    "arm_pneumatics": 2,
    "take_off": 2,
    "land": 1,
    "disarm": 1,
}
"""Relative frequency of each request."""


def _bends(act: Act) -> bool:
    return act.verb in ("move_switch", "press", "bend_to") and act.args[:1] != (0,)


def _when(random: Random, bends_s: list[float], lasts_s: float) -> float:
    """The start of a fault, mostly while the vine moves."""
    if bends_s and random.random() < 0.8:
        return min(lasts_s - 1.0, random.choice(bends_s) + random.uniform(0.1, 1.2))
    return random.uniform(2.0, lasts_s - 1.0)


def _fault(random: Random, setup: Setup, begins_s: float, lasts_s: float) -> Fault:
    begins_s = round(begins_s, 3)
    for_s = round(0.1 * (80.0 ** random.random()), 3)
    if random.random() < HARDWARE_SHARE:
        return _mishap(random, begins_s, lasts_s)
    name = random.choice(_faults(setup))
    if name == "RC blip":
        for_s = round(random.uniform(0.1, 0.95), 3)
    if name == "RC lost":
        for_s = round(0.2 * (40.0 ** random.random()), 3)
    ends_s = round(begins_s + for_s, 3)
    share = round(random.uniform(0.05, 0.6), 2)
    begin, end = _fault_acts(name, random, setup, for_s, share)
    return Fault(name, begins_s, begin, ends_s if end else None, end)


def _radio_fault(name: str, random: Random, setup: Setup, for_s: float) -> tuple[Act, Act | None]:
    if name == "RC overridden":
        return Act("override", (random.randrange(3),)), Act("stop_override")
    how: RcLoss = random.choice(LOSSES[setup.receiver or "pulses"])
    if how == "frozen" or setup.autopilot == "ardupilot" or random.random() < 0.2:
        return Act("lose_rc", (how,)), Act("return_rc")
    preset = {SWITCH: random.choice(PULSES_US)}
    if random.random() < 0.5:
        preset |= {channel: random.choice((1000, 1500, 2000)) for channel in random.sample(range(4, 9), 3)}
    return Act("lose_rc", (how, preset)), Act("return_rc")


def _faults(setup: Setup) -> tuple[str, ...]:
    """Faults of vehicle, companion and line; those of the radio most often."""
    more: tuple[str, ...] = (
        ("RC overridden", "RC overridden") if setup.autopilot == "ardupilot" else ("items lost",)
    )
    if setup.mission:
        more += ("mission replaced", "mission replaced", "mission replaced")
    if setup.has_rc:
        more += 4 * ("RC lost", "RC blip")
    return _FAULTS + more


_FAULTS = (
    "RC lost",
    "autopilot silent",
    "autopilot rebooted",
    "vehicle link closed",
    "vehicle link noisy",
    "vehicle link stalled",
    "vehicle link stalled",
    "disarmed in the air",
    "altitude lost",
    "serial unplugged",
    "commands lost",
    "telemetry lost",
    "serial noisy",
    "companion killed",
    "companion stalled",
    "companion stalled",
)


def _fault_acts(
    name: str, random: Random, setup: Setup, for_s: float, share: float
) -> tuple[Act, Act | None]:
    if name in ("RC lost", "RC blip", "RC overridden"):
        return _radio_fault(name, random, setup, for_s)
    if name == "mission replaced":
        return Act("replace_mission", (_other_numbers(setup.mission, setup.autopilot, random),)), None
    return {
        "items lost": (Act("lose_commands"), Act("find_commands")),
        "autopilot silent": (Act("mute", (for_s,)), None),
        "autopilot rebooted": (Act("reboot_autopilot"), None),
        "vehicle link closed": (Act("close_vehicle_link"), Act("open_vehicle_link")),
        "vehicle link noisy": (Act("spoil_vehicle_link", (share / 2,)), Act("mend_vehicle_link")),
        "vehicle link stalled": (Act("stall_vehicle_link", (for_s, share < 0.3)), None),
        "disarmed in the air": (Act("disarm"), None),
        "altitude lost": (Act("lose_altitude"), Act("find_altitude")),
        "serial unplugged": (Act("unplug"), Act("plug_in")),
        "commands lost": (Act("cut_commands"), Act("mend_line")),
        "telemetry lost": (Act("cut_telemetry"), Act("mend_line")),
        "serial noisy": (Act("spoil_line", (share,)), Act("mend_line")),
        "companion killed": (Act("kill_companion"), Act("start_companion")),
        "companion stalled": (Act("stall_companion", (for_s,)), None),
    }[name]


def _mishap(random: Random, begins_s: float, lasts_s: float) -> Fault:
    mishap = draw_mishap(random, lasts_s - begins_s)
    match mishap.kind:
        case StuckAt(opening):
            kind = "stuck " + ("shut" if opening == 0.0 else "open" if opening == 1.0 else "ajar")
        case Hole(bore_mm):
            kind = "burst" if bore_mm >= 2.0 else "leak"
        case _:
            kind = type(mishap.kind).__name__.lower()
    name = f"{mishap.place.replace('_', ' ')} {kind}"
    begin = Act("inject", (mishap.place, mishap.kind))
    if mishap.ends_s is None:
        return Fault(name, begins_s, begin)
    ends_s = round(begins_s + mishap.ends_s - mishap.begins_s, 3)
    return Fault(name, begins_s, begin, ends_s, Act("heal", (mishap.place,)))

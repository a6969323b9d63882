"""A simulated phloSAR: firmware, detailed plant, sensors, hardware failures (mishaps), and a serial port.

The phloSAR has a reservoir, valves, a Venturi and a Teensy. EVP: inflation valve. DVP: the Venturi's supply
valve.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import tty
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import monotonic

from flying_vines.physics.baseline import Inputs
from flying_vines.physics.gas import ALPHA_KPA, STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.numbers import PlantNumbers
from flying_vines.physics.plant.plant import Conditions, State, at_rest
from flying_vines.physics.plant.sensors import Sensor, reading, rested
from flying_vines.physics.plant.simulator import TICK_S, Simulator
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import Rig
from flying_vines.simulation.phlosar.firmware import SAFE, Board, Firmware, Settings
from flying_vines.simulation.phlosar.mishaps import (
    OPEN_SHARE,
    SHORTED_SHARE,
    WATCHDOG_MS,
    Filled,
    Hanging,
    Heated,
    MishapKind,
    Mishaps,
    Reset,
    SensorMishap,
    SensorReading,
    Unpowered,
    WatchdogReset,
    check_place,
    with_mishaps,
)

STEP_US = round(TICK_S * 1e6)
_UNPOWERED = Inputs(0.0, 0.0, False)


class SimulatedPhlosar:
    """Firmware and plant, stepped together at 1 kHz. Time starts at 0 and moves with `advance`.

    `rig` alone: all typical effects, and sensors behind a 12-bit converter. `rig` with `effects`: only these
    effects, and ideal sensors with noise; `Effects()` is the paper's ideal rig, and fast. A `TrueRig`
    specifies everything. `firmware` has settings for the simulated firmware, or is a board.

    To simulate a hardware failure, call `inject`, or set a field of `mishaps`, such as `phlosar.mishaps.evp =
    StuckAt(1.0)`. The failure acts from the next `advance` on. Set the field to None to repair the part.

    Equal seeds, bytes and times give equal bytes and pressures. `reservoir_kPa` and `cv_kPa` are the true
    pressures. The firmware reads them with noise. The control volume's sensor is at the valve end of
    its tube.
    """

    def __init__(
        self,
        rig: Rig | TrueRig | None = None,
        firmware: Settings | Board | None = None,
        *,
        effects: Effects | None = None,
        reservoir_kPa: float = 690.0,
        cv_kPa: float = 0.0,
        seed: int = 1,
    ) -> None:
        setup = (rig if isinstance(rig, TrueRig) else _true(rig or Rig(), effects)).setup
        self.firmware: Board = (
            Firmware(firmware) if firmware is None or isinstance(firmware, Mapping) else firmware
        )
        self.drive: Inputs = SAFE
        self.mishaps = Mishaps()
        self._applied = Mishaps()
        self._simulator = Simulator(setup.plant, at_rest(setup.plant, reservoir_kPa, cv_kPa))
        self._healthy = self._simulator.numbers
        self._conditions = self._simulator.conditions
        self._steps = 0
        self._hangs_until: int | None = None
        self._random = random.Random(seed)
        # A separate generator, so that a mishap does not change the other noise.
        noise = partial(random.Random(f"mishaps of {seed}").gauss, 0.0, 1.0)
        self._cv_sensor = _SensorChannel(setup.cv_sensor, cv_kPa, noise)
        self._reservoir_sensor = _SensorChannel(setup.reservoir_sensor, reservoir_kPa, noise)
        # At time 0 the board has booted and can receive.
        self._step_firmware()

    @property
    def now_s(self) -> float:
        return self._steps * STEP_US / 1e6

    @property
    def reservoir_kPa(self) -> float:
        return self._conditions.reservoir_kPa

    @property
    def cv_kPa(self) -> float:
        return self._conditions.cv_kPa

    @property
    def line_kPa(self) -> float:
        """Pressure at the valve end of the control volume's tube, where its sensor is."""
        return self._conditions.line_kPa

    @property
    def state(self) -> State:
        """The plant's state."""
        return self._simulator.state

    def receive(self, data: bytes) -> None:
        """Bytes from the host."""
        if self.mishaps.board is None:
            self.firmware.receive(data)

    def advance(self, to_t_s: float) -> bytes:
        """Simulate until `to_t_s`; a past time changes nothing. Returns the firmware's bytes."""
        last = round(to_t_s * 1e6) // STEP_US
        sent: list[bytes] = []
        self._apply_mishaps()
        while self._steps < last:
            self._step_plant()
            self._steps += 1
            self._step_firmware()
            # The firmware's own buffer is small; a long jump must not overflow it.
            if self._steps % 16 == 0:
                sent.append(self.firmware.take_output())
        sent.append(self.firmware.take_output())
        return b"".join(sent)

    def inject(self, place: str, kind: MishapKind | None) -> None:
        """Apply a mishap at a place. `kind` None repairs the place.

        A lasting mishap is stored in `mishaps` and acts from the next `advance` on. Others act at once.
        Raises `ValueError` if this place cannot have this mishap.
        """
        check_place(place, kind)
        match kind:
            case Filled(kPa):
                self.fill(kPa)
            case Heated(kelvin):
                self.heat_reservoir(kelvin)
            case Reset() | WatchdogReset():
                self.reset_firmware(watchdog=isinstance(kind, WatchdogReset))
            case _:
                setattr(self.mishaps, place, kind)

    def fill(self, reservoir_kPa: float) -> None:
        """Fill or empty the reservoir to this pressure, at constant temperature."""
        now = self._conditions
        ratio = (reservoir_kPa + now.ambient_kPa) / (now.reservoir_kPa + now.ambient_kPa)
        state = self.state
        air_SL = ratio * state.reservoir_air_SL
        self._put(
            state._replace(
                reservoir_air_SL=air_SL,
                reservoir_pV_J=ratio * state.reservoir_pV_J,
                vented_SL=state.vented_SL - (air_SL - state.reservoir_air_SL),
            )
        )

    def heat_reservoir(self, kelvin: float) -> None:
        """Heat reservoir and gas by `kelvin`.

        The gas of an isothermal model cannot be heated. This model gets air instead, so that the pressure
        rises by the same amount.
        """
        now = self._conditions
        ratio = 1.0 + kelvin / now.reservoir_K
        if not self._healthy.reservoir_heat.own_temperature:
            self.fill(ratio * (now.reservoir_kPa + now.ambient_kPa) - now.ambient_kPa)
            return
        state = self.state
        self._put(
            state._replace(
                reservoir_pV_J=ratio * state.reservoir_pV_J,
                reservoir_wall_K=state.reservoir_wall_K + kelvin,
            )
        )

    def reset_firmware(self, *, watchdog: bool = False) -> None:
        """Reset the firmware by a short power loss, or by its watchdog."""
        self.firmware.reset(watchdog=watchdog)
        self._step_firmware()

    def _put(self, state: State) -> None:
        self._simulator.state = state
        self._conditions = self._simulator.conditions

    def _apply_mishaps(self) -> None:
        """Apply all changes of `mishaps`."""
        now, before = self.mishaps, self._applied
        if now == before:
            return
        self._applied = replace(now)
        self._cv_sensor.set_mishap(now.cv_sensor)
        self._reservoir_sensor.set_mishap(now.reservoir_sensor)
        numbers = with_mishaps(self._healthy, now)
        if numbers.has_tubing != self._simulator.numbers.has_tubing:
            self._put(_with_stub(numbers, self.state, self._conditions))
        self._simulator.numbers = numbers
        self._conditions = self._simulator.conditions
        if now.board != before.board:
            self._apply_to_board(before.board)

    def _apply_to_board(self, before: Unpowered | Hanging | None) -> None:
        board = self.mishaps.board
        self._hangs_until = self._steps + WATCHDOG_MS if isinstance(board, Hanging) else None
        if isinstance(board, Unpowered):
            self.drive = _UNPOWERED
        elif isinstance(before, Unpowered):
            self.firmware.reset()

    def _step_plant(self) -> None:
        command = self.drive
        if self._applied.solenoid is not None:
            command = command._replace(solenoid=self._applied.solenoid.opening >= 0.5)
        if self._applied.venturi is not None:
            blown = command.dvp if command.solenoid else 0.0
            command = Inputs(max(command.evp, blown), 0.0, False)
        if self._simulator.advance(command):
            self._conditions = self._simulator.conditions

    def _step_firmware(self) -> None:
        gauss = self._random.gauss
        cv_kPa = self._cv_sensor.read(self.line_kPa, gauss(0.0, 1.0))
        reservoir_kPa = self._reservoir_sensor.read(self.reservoir_kPa, gauss(0.0, 1.0))
        if self._applied.board is not None and not self._reset_by_watchdog():
            return
        self.drive = self.firmware.step(self._steps * STEP_US, cv_kPa, reservoir_kPa)

    def _reset_by_watchdog(self) -> bool:
        """Reset a hanging board if its watchdog time is over. True if the board was reset."""
        if self._hangs_until is None or self._steps < self._hangs_until:
            return False
        self.mishaps.board = self._applied.board = self._hangs_until = None
        self.firmware.reset(watchdog=True)
        return True


class _SensorChannel:
    """A sensor with its wire; it may have a mishap."""

    def __init__(self, sensor: Sensor, kPa: float, noise: Callable[[], float]) -> None:
        self._numbers = sensor.numbers
        self._seen = rested(kPa)
        self._noise = noise
        self._mishap: SensorMishap | None = None
        self._last_kPa = kPa
        self._for_ms = 0

    def set_mishap(self, mishap: SensorMishap | None) -> None:
        if mishap != self._mishap:
            self._mishap = mishap
            self._for_ms = 0

    def read(self, true_kPa: float, standard_normal: float) -> float:
        """The board's reading, one tick after the last one."""
        self._seen, kPa = reading(self._numbers, self._seen, true_kPa, TICK_S, standard_normal)
        if self._mishap is None:
            self._last_kPa = kPa
            return kPa
        self._for_ms += 1
        kPa = self._mishap.read(SensorReading(kPa, self._last_kPa, self._for_ms, self._noise))
        span_kPa = self._numbers.span_kPa
        return min(SHORTED_SHARE * span_kPa, max(OPEN_SHARE * span_kPa, kPa))


def _with_stub(numbers: PlantNumbers, state: State, now: Conditions) -> State:
    """Divides the control volume's air between line and actuator if the model now has a line. Puts the line's
    air back into the actuator if the model no longer has a line."""
    ratio = now.ambient_K / STANDARD_TEMPERATURE_K
    into_SL = -state.line_air_SL
    if numbers.has_tubing:
        into_SL = (now.line_kPa + now.ambient_kPa) / (ratio * numbers.line_kPa_per_SL)
    return state._replace(
        cv_air_SL=state.cv_air_SL - into_SL,
        cv_energy_J=state.cv_energy_J - ALPHA_KPA * ratio * into_SL,
        line_air_SL=state.line_air_SL + into_SL,
    )


def _true(rig: Rig, effects: Effects | None) -> TrueRig:
    return TrueRig(rig, likely=True) if effects is None else TrueRig(rig, effects=effects)


_PTY_PERIOD_S = 0.005
_MAX_LAG_S = 0.5
_READ_SIZE = 4096


class PtyPhlosar:
    """A simulated phloSAR behind a pseudo-terminal, in real time.

    `path` is the port to open: `symlink` if given (an old link is replaced; other files raise
    `FileExistsError`), else /dev/pts/N. After `close` another terminal may get the same N. Hosts may close
    and reopen the port. Bytes that do not fit into the terminal's buffer are dropped and counted. Use as a
    context manager, or call `close`.
    """

    def __init__(
        self,
        phlosar: SimulatedPhlosar,
        symlink: Path | str | None = None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self.phlosar = phlosar
        self.dropped_bytes = 0
        self._clock = clock
        # Keep the host side open, otherwise the terminal closes when the first host disconnects.
        self._ours, self._hosts = os.openpty()
        self._symlink: Path | None = None
        try:
            tty.setraw(self._hosts)
            os.set_blocking(self._ours, False)
            self._terminal = self.path = os.ttyname(self._hosts)
            if symlink is not None:
                self._link(Path(symlink))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> PtyPhlosar:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the terminal, as if unplugged."""
        if self._ours < 0:
            return
        # Remove the link first: after the close, another terminal may get the same name.
        if self._symlink is not None:
            with contextlib.suppress(OSError):
                if str(self._symlink.readlink()) == self._terminal:
                    self._symlink.unlink()
        os.close(self._ours)
        os.close(self._hosts)
        self._ours = self._hosts = -1

    async def run(self) -> None:
        """Run in real time until cancelled. A long pause of this process also pauses the board."""
        began_s = self._clock() - self.phlosar.now_s
        while self._ours >= 0:
            now_s = self._clock() - began_s
            behind_s = now_s - self.phlosar.now_s - _MAX_LAG_S
            if behind_s > 0:
                began_s += behind_s
                now_s -= behind_s
            self._turn(now_s)
            await asyncio.sleep(_PTY_PERIOD_S)

    def _turn(self, now_s: float) -> None:
        with contextlib.suppress(BlockingIOError):
            self.phlosar.receive(os.read(self._ours, _READ_SIZE))
        output = self.phlosar.advance(now_s)
        if not output:
            return
        written = 0
        with contextlib.suppress(BlockingIOError):
            written = os.write(self._ours, output)
        self.dropped_bytes += len(output) - written

    def _link(self, symlink: Path) -> None:
        if symlink.is_symlink():
            symlink.unlink()
        elif symlink.exists():
            raise FileExistsError(f"{symlink} is not a link and is not replaced")
        symlink.symlink_to(self._terminal)
        self._symlink, self.path = symlink, str(symlink)

"""A phloSAR that is not there: emulated firmware, the high-fidelity plant, its sensors, and a serial port."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import tty
from collections.abc import Callable
from pathlib import Path
from time import monotonic

from flying_vines.fakes.firmware import SAFE, Drive, Firmware, FirmwareSettings
from flying_vines.pneumatics.baseline import Inputs
from flying_vines.pneumatics.plant.effects import Effects
from flying_vines.pneumatics.plant.plant import at_rest
from flying_vines.pneumatics.plant.sensors import read, rested
from flying_vines.pneumatics.plant.simulator import TICK_S, Simulator
from flying_vines.pneumatics.plant.true_rig import TrueRig
from flying_vines.pneumatics.rig import Rig

STEP_US = round(TICK_S * 1e6)


class SimulatedPhlosar:
    """Firmware and plant, stepped together at 1 kHz. Time starts at 0 and is what `advance` says.

    A rig is as it probably is: with all its effects, and sensors behind a converter of 12 bits. With
    `effects` it has these and perfect sensors but for the noise: `Effects()` is the paper's ideal one, and
    quick. A `TrueRig` says everything itself.

    The same seed, bytes and times give the same bytes and pressures. `reservoir_kPa` and `cv_kPa` are the
    true pressures; the firmware sees them with noise, and the control volume's at the near end of its tube.
    """

    def __init__(
        self,
        rig: Rig | TrueRig | None = None,
        settings: FirmwareSettings | None = None,
        *,
        effects: Effects | None = None,
        reservoir_kPa: float = 690.0,
        cv_kPa: float = 0.0,
        seed: int = 1,
    ) -> None:
        setup = (rig if isinstance(rig, TrueRig) else _true(rig or Rig(), effects)).setup
        self.firmware = Firmware(settings)
        self.drive: Drive = SAFE
        self.reservoir_leak_kPa_per_s = 0.0
        """A hole that someone made just now, beside the leaks that the rig has."""
        self._cv_sensor, self._reservoir_sensor = setup.cv_sensor, setup.reservoir_sensor
        self._seen_cv, self._seen_reservoir = rested(cv_kPa), rested(reservoir_kPa)
        self._simulator = Simulator(setup.plant, at_rest(setup.plant, reservoir_kPa, cv_kPa))
        self._conditions = self._simulator.conditions
        self._steps = 0
        self._random = random.Random(seed)
        # At time 0 the board has booted and listens.
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

    def receive(self, data: bytes) -> None:
        """Bytes from the host."""
        self.firmware.receive(data)

    def advance(self, to_t_s: float) -> bytes:
        """Live until `to_t_s`; what the firmware sent on the way. A time in the past changes nothing."""
        last = round(to_t_s * 1e6) // STEP_US
        sent: list[bytes] = []
        while self._steps < last:
            self._step_plant()
            self._steps += 1
            self._step_firmware()
            # The firmware's own buffer is small; a long jump must not overflow it.
            if self._steps % 64 == 0:
                sent.append(self.firmware.take_output())
        sent.append(self.firmware.take_output())
        return b"".join(sent)

    def fill(self, reservoir_kPa: float) -> None:
        """Someone opens the filling valve, or another one, until the reservoir has this pressure.

        Its temperature stays as it is.
        """
        now = self._conditions
        ratio = (reservoir_kPa + now.ambient_kPa) / (now.reservoir_kPa + now.ambient_kPa)
        state = self._simulator.state
        self._simulator.state = state._replace(
            reservoir_air_SL=ratio * state.reservoir_air_SL, reservoir_pV_J=ratio * state.reservoir_pV_J
        )
        self._conditions = self._simulator.conditions

    def reset_firmware(self, *, watchdog: bool = False) -> None:
        """The board's power blinks, or its watchdog barks; the air stays where it is."""
        self.firmware.reset(watchdog=watchdog)
        self._step_firmware()

    def _step_plant(self) -> None:
        self._simulator.advance(Inputs(*self.drive))
        self._conditions = self._simulator.conditions
        if self.reservoir_leak_kPa_per_s:
            self.fill(max(0.0, self.reservoir_kPa - self.reservoir_leak_kPa_per_s * TICK_S))

    def _step_firmware(self) -> None:
        gauss = self._random.gauss
        self._seen_cv, cv_kPa = read(
            self._cv_sensor, self._seen_cv, self._conditions.line_kPa, TICK_S, gauss(0.0, 1.0)
        )
        self._seen_reservoir, reservoir_kPa = read(
            self._reservoir_sensor, self._seen_reservoir, self.reservoir_kPa, TICK_S, gauss(0.0, 1.0)
        )
        self.drive = self.firmware.step(self._steps * STEP_US, cv_kPa, reservoir_kPa)


def _true(rig: Rig, effects: Effects | None) -> TrueRig:
    return TrueRig(rig, likely=True) if effects is None else TrueRig(rig, effects=effects)


_TICK_S = 0.005
_MOST_BEHIND_S = 0.5
_READ_SIZE = 4096


class PtyPhlosar:
    """A simulated phloSAR behind a pseudo-terminal, in real time.

    `path` is the port to open, from construction on; `symlink` is a stable name for it, made anew when it
    is a leftover link (FileExistsError when it is anything else). Hosts may close and open the port as
    they like. What no host reads is dropped, and counted, as on a wire. Use as a context manager, or
    call `close`.
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
        # Our own hold on the host's end: without it the first host to leave would end the terminal.
        self._ours, self._hosts = os.openpty()
        self._symlink: Path | None = None
        try:
            tty.setraw(self._hosts)
            os.set_blocking(self._ours, False)
            self.path = os.ttyname(self._hosts)
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
        """Unplug it."""
        if self._ours < 0:
            return
        os.close(self._ours)
        os.close(self._hosts)
        self._ours = self._hosts = -1
        if self._symlink is not None:
            with contextlib.suppress(OSError):
                if str(self._symlink.readlink()) == self.path:
                    self._symlink.unlink()

    async def run(self) -> None:
        """Live in real time until cancelled. After a stall of this process the board's time stands still."""
        began_s = self._clock() - self.phlosar.now_s
        while self._ours >= 0:
            now_s = self._clock() - began_s
            behind_s = now_s - self.phlosar.now_s - _MOST_BEHIND_S
            if behind_s > 0:
                began_s += behind_s
                now_s -= behind_s
            self._turn(now_s)
            await asyncio.sleep(_TICK_S)

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
            raise FileExistsError(f"{symlink} is not a link and stays as it is")
        symlink.symlink_to(self.path)
        self._symlink = symlink

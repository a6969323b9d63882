"""A phloSAR that is not there: emulated firmware, the baseline plant, noisy sensors, and a serial port."""

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
from flying_vines.pneumatics.baseline import Inputs, State, step
from flying_vines.pneumatics.rig import Rig

STEP_US = 1000
_CV_SENSOR_SPAN_KPA = 206.84
_RESERVOIR_SENSOR_SPAN_KPA = 1500.0
_ADC_REFERENCE_OF_SPAN = 3.3 / 4.0
"""The sensors' span is 4 V, the converter's reference 3.3 V."""


class SimulatedPhlosar:
    """Firmware and plant, stepped together at 1 kHz. Time starts at 0 and is what `advance` says.

    The same seed, bytes and times give the same bytes and pressures. `reservoir_kPa` and `cv_kPa` are the
    true pressures; the firmware sees them with the rig's noise, and through a converter of `adc_bits` if
    that is given.
    """

    def __init__(
        self,
        rig: Rig | None = None,
        settings: FirmwareSettings | None = None,
        *,
        reservoir_kPa: float = 690.0,
        cv_kPa: float = 0.0,
        seed: int = 1,
        adc_bits: int | None = None,
        reservoir_leak_kPa_per_s: float = 0.0,
    ) -> None:
        self.rig = rig or Rig()
        self.firmware = Firmware(settings)
        self.drive: Drive = SAFE
        self.reservoir_leak_kPa_per_s = reservoir_leak_kPa_per_s
        self._state = State(reservoir_kPa, cv_kPa)
        self._steps = 0
        self._random = random.Random(seed)
        self._cv_lsb_kPa = self._reservoir_lsb_kPa = 0.0
        if adc_bits is not None:
            self._cv_lsb_kPa = _CV_SENSOR_SPAN_KPA * _ADC_REFERENCE_OF_SPAN / (1 << adc_bits)
            self._reservoir_lsb_kPa = _RESERVOIR_SENSOR_SPAN_KPA * _ADC_REFERENCE_OF_SPAN / (1 << adc_bits)
        # At time 0 the board has booted and listens.
        self._step_firmware()

    @property
    def now_s(self) -> float:
        return self._steps * STEP_US / 1e6

    @property
    def reservoir_kPa(self) -> float:
        return self._state.reservoir_kPa

    @property
    def cv_kPa(self) -> float:
        return self._state.cv_kPa

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
        """Someone opens the filling valve until the reservoir has this pressure."""
        self._state = State(reservoir_kPa, self._state.cv_kPa)

    def reset_firmware(self, *, watchdog: bool = False) -> None:
        """The board's power blinks, or its watchdog barks; the air stays where it is."""
        self.firmware.reset(watchdog=watchdog)
        self._step_firmware()

    def _step_plant(self) -> None:
        dt_s = STEP_US / 1e6
        reservoir_kPa, cv_kPa = step(self.rig, self._state, Inputs(*self.drive), dt_s)
        if self.reservoir_leak_kPa_per_s:
            reservoir_kPa = max(0.0, reservoir_kPa - self.reservoir_leak_kPa_per_s * dt_s)
        self._state = State(reservoir_kPa, cv_kPa)

    def _step_firmware(self) -> None:
        sensors, state, gauss = self.rig.sensors, self._state, self._random.gauss
        cv_kPa = gauss(state.cv_kPa, sensors.cv_noise_std_kPa)
        reservoir_kPa = gauss(state.reservoir_kPa, sensors.reservoir_noise_std_kPa)
        if self._cv_lsb_kPa:
            cv_kPa = round(cv_kPa / self._cv_lsb_kPa) * self._cv_lsb_kPa
            reservoir_kPa = round(reservoir_kPa / self._reservoir_lsb_kPa) * self._reservoir_lsb_kPa
        self.drive = self.firmware.step(self._steps * STEP_US, cv_kPa, reservoir_kPa)


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

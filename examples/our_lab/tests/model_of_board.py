"""A model of the air pump's board: what it does with each line, and the pressure that follows."""

RATES_KPA_PER_S = {b"I": 40.0, b"H": 0.0, b"D": -40.0, b"V": -60.0}
DEAD_MAN_S = 0.2
STEP_S = 0.01
REPORT_EVERY = 2


class Board:
    def __init__(self) -> None:
        self.pressure_kPa = 0.0
        self._state, self._line, self._received_at, self._steps = b"V", b"", 0.0, 0

    def receive(self, data: bytes) -> None:
        *lines, self._line = (self._line + data).split(b"\n")
        for line in lines:
            if line in RATES_KPA_PER_S:
                self._state, self._received_at = line, self._steps * STEP_S

    def advance(self, t: float) -> bytes:
        sent = b""
        while (self._steps + 1) * STEP_S <= t + 1e-9:
            self._steps += 1
            if self._steps * STEP_S - self._received_at > DEAD_MAN_S:
                self._state = b"V"
            self.pressure_kPa = max(0.0, self.pressure_kPa + RATES_KPA_PER_S[self._state] * STEP_S)
            if self._steps % REPORT_EVERY == 0:
                sent += b"%.2f %s\n" % (self.pressure_kPa, b"V" if self._state == b"V" else b"A")
        return sent

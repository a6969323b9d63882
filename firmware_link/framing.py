"""Frames on the wire: COBS, a CRC-16, and a zero byte at the end of each.

    frame = COBS(payload + CRC-16 of the payload, high byte first) + 0x00

The CRC is CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF). The CRC of b"123456789" is 0x29B1. The high
byte comes first, so the CRC over payload and CRC together is zero. With COBS a zero byte occurs only at the
end of a frame. So a receiver that starts in the middle of a frame is synchronised at the next zero.
"""

from __future__ import annotations

import binascii

FRAME_END = b"\x00"
"""Between frames it has no effect. It ends an incomplete frame, so that the next frame can be read."""
MAX_PAYLOAD = 128
"""Bytes. The longest message has less than half of this. The rest is reserved for later messages."""

_CRC_START = 0xFFFF
_CRC_SIZE = 2
_COBS_BLOCK = 254
_MAX_ENCODED = MAX_PAYLOAD + _CRC_SIZE + (MAX_PAYLOAD + _CRC_SIZE) // _COBS_BLOCK + 1


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE of `data`, 0…0xFFFF."""
    return binascii.crc_hqx(data, _CRC_START)


def cobs_encode(data: bytes) -> bytes:
    """`data` with no zero byte in it (consistent overhead byte stuffing)."""
    encoded = bytearray()
    groups = data.split(b"\x00")
    for group in groups:
        while len(group) >= _COBS_BLOCK:
            encoded.append(_COBS_BLOCK + 1)
            encoded += group[:_COBS_BLOCK]
            group = group[_COBS_BLOCK:]
        encoded.append(len(group) + 1)
        encoded += group
    return bytes(encoded)


def cobs_decode(encoded: bytes) -> bytes | None:
    """The inverse of `cobs_encode`; None if `encoded` is not valid."""
    data = bytearray()
    at = 0
    while at < len(encoded):
        code = encoded[at]
        end = at + code
        if code == 0 or end > len(encoded):
            return None
        data += encoded[at + 1 : end]
        at = end
        if code <= _COBS_BLOCK and at < len(encoded):
            data.append(0)
    return bytes(data)


def encode_frame(payload: bytes) -> bytes:
    """A complete frame with its final zero byte. Raises ValueError above `MAX_PAYLOAD` bytes."""
    if len(payload) > MAX_PAYLOAD:
        raise ValueError(f"a payload of {len(payload)} bytes is too long: the maximum is {MAX_PAYLOAD}")
    return cobs_encode(payload + crc16(payload).to_bytes(_CRC_SIZE, "big")) + FRAME_END


class FrameDecoder:
    """Splits bytes into payloads. Stores at most one frame. Never raises.

    After invalid bytes it reads the first frame that follows a zero byte. Consecutive zero bytes are not
    frames.
    """

    def __init__(self) -> None:
        self.good_frames = 0
        self.bad_frames = 0
        self._buffer = bytearray()
        self._oversize = False

    def feed(self, data: bytes) -> list[bytes]:
        """The payloads of the frames that end within `data` and have a correct CRC, in order."""
        return [payload for _, payload in self.frames(data) if payload is not None]

    def frames(self, data: bytes) -> list[tuple[bytes, bytes | None]]:
        """(bytes on the wire, payload) of everything that ends within `data`, in order.

        The payload is None if the bytes are not a frame. If there are more bytes than in any frame, only
        their end is returned, or b"".
        """
        ended: list[tuple[bytes, bytes | None]] = []
        *ends, rest = data.split(FRAME_END)
        for piece in ends:
            self._hold(piece)
            wire, oversize = bytes(self._buffer), self._oversize
            self._buffer.clear()
            self._oversize = False
            if wire or oversize:
                ended.append((wire, self._payload(wire, oversize)))
        self._hold(rest)
        return ended

    def _hold(self, piece: bytes) -> None:
        if len(self._buffer) + len(piece) > _MAX_ENCODED:
            self._oversize = True
            self._buffer.clear()
        else:
            self._buffer += piece

    def _payload(self, wire: bytes, oversize: bool) -> bytes | None:
        checked = None if oversize else cobs_decode(wire)
        if checked is None or len(checked) < _CRC_SIZE or crc16(checked) != 0:
            self.bad_frames += 1
            return None
        self.good_frames += 1
        return checked[:-_CRC_SIZE]

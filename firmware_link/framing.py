"""Frames on the wire: COBS, a CRC-16, and a zero byte at the end of each.

    frame = COBS(payload + CRC-16 of the payload, high byte first) + 0x00

The CRC is CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF); of b"123456789" it is 0x29B1. High byte
first, so that the CRC over payload and CRC together is zero. COBS keeps the zero byte for the end of a
frame alone: whoever joins in the middle is in step again at the next zero.
"""

from __future__ import annotations

import binascii

FRAME_END = b"\x00"
"""Alone it is idle line; after half a frame it ends that, so that the next one is read."""
MAX_PAYLOAD = 128
"""Bytes. The longest message is less than half of this; the rest is room for later ones."""

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
    """What `cobs_encode` was given, or None when no data encodes to this."""
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
    """One whole frame, its final zero byte included. ValueError above `MAX_PAYLOAD` bytes."""
    if len(payload) > MAX_PAYLOAD:
        raise ValueError(
            f"a payload of {len(payload)} bytes is longer than the {MAX_PAYLOAD} that fit a frame"
        )
    return cobs_encode(payload + crc16(payload).to_bytes(_CRC_SIZE, "big")) + FRAME_END


class FrameDecoder:
    """Bytes in, payloads out; holds at most one frame's worth of bytes whatever it is fed.

    Never raises. After any garbage the first frame that follows a zero byte is read. Zero bytes in a
    row are idle line, not frames.
    """

    def __init__(self) -> None:
        self.good_frames = 0
        self.bad_frames = 0
        self._buffer = bytearray()
        self._oversize = False

    def feed(self, data: bytes) -> list[bytes]:
        """The payloads of the frames that end within `data` and whose CRC is right, in order."""
        return [payload for _, payload in self.frames(data) if payload is not None]

    def frames(self, data: bytes) -> list[tuple[bytes, bytes | None]]:
        """What ends within `data`, in order: the bytes on the wire, and the payload unless they are no frame.

        Of what is too long to be a frame there are no bytes.
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

"""The bytes of Xsens' motion trackers (MTi, MTw): Xbus messages, and the packets of MTData2 within one.

A message is 0xFA, bus id, message id, length, data, checksum: all bytes but the first add up to 0 modulo 256. A length of 0xFF is
followed by the true one in two bytes. Numbers are big-endian. MTData2 is a row of packets: data id (2 bytes), size, data; the low
nibble of a data id says the format of its numbers and the world's axes.

References
----------
Movella, "MT Low Level Communication Protocol Documentation" (MT0101P).
The vendor's public headers have the same numbers: `xsxbusmessageid.h`, `xsdataidentifier.h`, `xsresultvalue.h` of its MT SDK.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

import numpy as np

from cabinpose.signals import F64

PREAMBLE: Final = 0xFA
MASTER: Final = 0xFF  # the bus id of a tracker alone on its line, and of what speaks for several

REQUEST_ID, DEVICE_ID = 0x00, 0x01
INIT_BUS, BUS_RESULTS = 0x02, 0x03
TO_MEASUREMENT, TO_CONFIG = 0x10, 0x30
DATA, ERROR = 0x36, 0x42
OUTPUTS = 0xC0  # set, with data, or asked for, without; an answer has the id of its question plus one

PACKET_COUNTER, TIME_FINE = 0x1020, 0x1060
QUATERNION, ACCELERATION, TURN_RATE, MAGNETIC_FIELD, STATUS = 0x2010, 0x4020, 0x8020, 0xC020, 0xE020
COUNTER_VALUES, TICK_NS = 1 << 16, 100_000  # of the packet counter; of the fine sample time, which has 32 bits
EACH_SAMPLE: Final = 0xFFFF  # the rate of what comes with every sample
_KIND, _FORMAT = 0xFFF0, 0x3
_FIXED_1220, _FIXED_1632, _DOUBLE = 1, 2, 3
_LONGEST = 2048
ERRORS: Final = {
    0x03: "invalid period",
    0x04: "invalid message",
    0x1E: "timer overflow",
    0x20: "invalid baud rate",
    0x21: "invalid parameter",
}


class XbusMessage(NamedTuple):
    """A message: who it is from or for, what it is, its data."""

    bus: int
    kind: int
    data: bytes


def encode(message: XbusMessage) -> bytes:
    """The bytes of a message."""
    count = len(message.data)
    length = bytes([count]) if count < 0xFF else b"\xff" + struct.pack(">H", count)
    body = bytes([message.bus, message.kind]) + length + message.data
    return bytes([PREAMBLE]) + body + bytes([-sum(body) & 0xFF])


class XbusSplitter:
    """Messages out of bytes as they come. `malformed` counts those whose checksum is wrong; what is none is stepped over."""

    def __init__(self) -> None:
        self.malformed = 0
        self._bytes = b""

    def feed(self, data: bytes) -> list[XbusMessage]:
        """The whole messages that end in `data`."""
        rest, found = self._bytes + data, []
        while True:
            begin = rest.find(PREAMBLE)
            if begin < 0:
                rest = b""
                break
            rest = rest[begin:]
            if len(rest) < 5:
                break
            head, count = (4, rest[3]) if rest[3] < 0xFF else (6, int.from_bytes(rest[4:6], "big"))
            end = head + count + 1
            if count > _LONGEST:
                rest = rest[1:]
            elif len(rest) < end:
                break
            elif sum(rest[1:end]) & 0xFF:
                self.malformed += 1
                rest = rest[1:]  # the length may be what is wrong: the next message is looked for within
            else:
                found.append(XbusMessage(rest[1], rest[2], rest[head : end - 1]))
                rest = rest[end:]
        self._bytes = rest
        return found


def packets(data: bytes) -> dict[int, bytes]:
    """The packets of an MTData2 message by data id, with its low nibble. Raises ValueError where one is cut off."""
    found, at = {}, 0
    while at < len(data):
        if at + 3 > len(data) or at + 3 + data[at + 2] > len(data):
            raise ValueError("a packet of MTData2 is cut off")
        kind, size = struct.unpack_from(">HB", data, at)
        found[kind] = data[at + 3 : at + 3 + size]
        at += 3 + size
    return found


def numbers(of: dict[int, bytes], kind: int, count: int) -> F64:
    """(1, count) values of a data id in any format, (0, count) where it did not come. Raises ValueError for another count."""
    found = next((each for each in of if each & _KIND == kind), None)
    if found is None:
        return np.zeros((0, count))
    data = of[found]
    form = found & _FORMAT
    if form == _FIXED_1632:  # 32 bits behind the point, then 16 signed ones before it
        rows = np.frombuffer(data, np.dtype([("low", ">u4"), ("high", ">i2")]))
        values = rows["high"] + rows["low"] / 2.0**32
    elif form == _FIXED_1220:
        values = np.frombuffer(data, ">i4") / 2.0**20
    else:
        values = np.frombuffer(data, ">f8" if form == _DOUBLE else ">f4").astype(np.float64)
    if len(values) != count:
        raise ValueError(f"{len(values)} numbers of data id 0x{found:04X}, not {count}")
    return values[None]


def whole_number(of: dict[int, bytes], kind: int) -> int | None:
    """An unsigned whole number, None where it did not come."""
    data = of.get(kind)
    return None if data is None else int.from_bytes(data, "big")

"""CRC-16/MCRF4XX, the checksum of MAVLink, of many frames at once: one step a byte, all frames side by side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_POLYNOMIAL = 0x8408  # x^16 + x^12 + x^5 + 1, reflected


def _table() -> NDArray[np.uint16]:
    crc = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        crc = np.where(crc & 1, crc >> 1 ^ _POLYNOMIAL, crc >> 1).astype(np.uint16)
    return crc


_TABLE = _table()


def checksums(
    data: NDArray[np.uint8], start: NDArray[np.int64], length: NDArray[np.int64], seed: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The checksum of `length` bytes from each `start`, followed by the message's own seed byte."""
    longest_first = np.argsort(-length, kind="stable")
    start, negative_length = start[longest_first], -length[longest_first]
    crc = np.full(len(start), 0xFFFF, np.uint16)
    for step in range(-int(negative_length[0]) if len(start) else 0):
        going_on = int(negative_length.searchsorted(-step))  # frames longer than `step` stand in front
        crc[:going_on] = _next(crc[:going_on], data[start[:going_on] + step])
    found = np.empty(len(start), np.int64)
    found[longest_first] = _next(crc, seed[longest_first].astype(np.uint8))
    return found


def _next(crc: NDArray[np.uint16], byte: NDArray[np.uint8]) -> NDArray[np.uint16]:
    return np.asarray(crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF], np.uint16)

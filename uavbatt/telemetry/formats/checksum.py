"""CRC-16/MCRF4XX, the checksum of MAVLink, of many frames at once: one step for two bytes, all frames side by side."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

_POLYNOMIAL = 0x8408  # x^16 + x^12 + x^5 + 1, reflected

Checksums = NDArray[np.uint16]


def checksums(
    data: NDArray[np.uint8], start: NDArray[np.int64], length: NDArray[np.int64], seed: NDArray[np.int64]
) -> Checksums:
    """Return the checksum of `length` bytes from each `start`, followed by the message's own seed byte."""
    longest_first = np.argsort(-length, kind="stable")
    start, length = start[longest_first], length[longest_first]
    table, crc = _after_two(), np.full(len(start), 0xFFFF, np.uint16)
    fewer_pairs = -(length // 2)
    for step in range(-int(fewer_pairs[0]) if len(start) else 0):
        going_on = int(fewer_pairs.searchsorted(-step))  # frames with more pairs than `step` stand in front
        at = start[:going_on] + 2 * step
        crc[:going_on] = table[crc[:going_on] ^ data[at] ^ data[at + 1].astype(np.uint16) << 8]
    odd = np.flatnonzero(length & 1)
    crc[odd] = _after(crc[odd] ^ data[start[odd] + length[odd] - 1])
    found = np.empty_like(crc)
    found[longest_first] = _after(crc ^ seed[longest_first].astype(np.uint16))
    return found


def _after(mixed: Checksums) -> Checksums:
    """Return the checksum after a byte; mixed: the checksum before, with the byte XORed into its lower half."""
    return np.asarray(mixed >> 8 ^ _of_byte()[mixed & 0xFF], np.uint16)


@cache
def _of_byte() -> Checksums:
    crc = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        crc = np.where(crc & 1, crc >> 1 ^ _POLYNOMIAL, crc >> 1).astype(np.uint16)
    return crc


@cache
def _after_two() -> Checksums:
    """Return the table of `_after` applied twice to every 16 bits, so that one look-up takes two bytes."""
    return _after(_after(np.arange(1 << 16, dtype=np.uint16)))

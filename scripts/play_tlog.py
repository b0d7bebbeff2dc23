"""A telemetry log as a vehicle on a socket: `play_tlog.py LOG udpout:127.0.0.1:14551 [--speed 1]`.

--speed scales time.
"""

from __future__ import annotations

import argparse
import struct
import time
from pathlib import Path

from uavbatt.mavlink.framing import frame_length
from uavbatt.mavlink.links import open_link


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("endpoint")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--seconds", type=float, default=1e9)
    args = parser.parse_args()
    if args.log.suffix.lower() != ".tlog" or not args.log.is_file():
        parser.error(f"{args.log}: expected a .tlog file")
    link, data = open_link(args.endpoint), args.log.read_bytes()
    position, first_us, start_s = 0, 0, time.monotonic()
    while position + 8 < len(data):
        (stamp_us,) = struct.unpack_from(">Q", data, position)
        length = frame_length(data, position + 8)
        if length < 1:
            parser.exit(1, f"{args.log}: no frame at byte {position + 8}: damaged from there on\n")
        first_us = first_us or stamp_us
        due_s = start_s + (stamp_us - first_us) / 1e6 / args.speed
        if due_s - start_s > args.seconds:
            break
        while (now_s := time.monotonic()) < due_s:
            link.read(now_s)
            time.sleep(min(due_s - now_s, 0.02))
        link.read(now_s)
        link.write(data[position + 8 : position + 8 + length], now_s)
        position += 8 + length


if __name__ == "__main__":
    main()

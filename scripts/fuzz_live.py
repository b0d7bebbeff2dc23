"""Noise and mutated frames against daemon and proxy: `fuzz_live.py [--frames 1000000] [--seed 1]`.

A pack in flight sends a good row now and then; between, the line brings random bytes, cut frames, flipped bits,
spliced frames, other lengths and ids, wrong checksums. Nothing may raise. An estimate is forged when it rests on a row
that nobody sent (a checksum of 16 bits lets one damaged frame of 65 536 through: what slips through is counted, and
must be caught behind the reader); the rewriter has forged when it changed anything but a good frame of the vehicle.
"""

from __future__ import annotations

import argparse
import random
import struct
import sys
import time
from typing import Any

from daemon_bench import Bench
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import FeedSection
from uavbatt.live.feeds.rewriter import ESTIMATE_LAYOUT, OK, Rewriter
from uavbatt.mavlink import framing
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat
from uavbatt.telemetry.link.live_row import LiveRow
from uavbatt.telemetry.link.vehicle import Vehicle

CURRENT_A, VOLTAGE_V = 12.0, 16.0
A_TURN = 50
GOOD_EVERY_S = 0.2


def mutated(dice: random.Random, good: list[bytes]) -> bytes:
    """Return one of the good frames damaged in some way, or random bytes."""
    frame = bytearray(dice.choice(good))
    kind = dice.randrange(8)
    if kind == 0:
        return dice.randbytes(dice.randrange(1, 280))
    if kind == 1:
        return bytes(frame[: dice.randrange(1, len(frame))])
    if kind == 2:
        for _ in range(dice.randrange(1, 4)):
            frame[dice.randrange(len(frame))] ^= 1 << dice.randrange(8)
    elif kind == 3:
        for _ in range(dice.randrange(1, 12)):
            frame[dice.randrange(1, len(frame))] = dice.randrange(256)
    elif kind == 4:
        frame[1] = dice.randrange(256)
    elif kind == 5:
        other = dice.choice(good)
        cut = dice.randrange(1, min(len(frame), len(other)))
        frame = frame[:cut] + bytearray(other[cut:])
        frame[-1] ^= 1 + dice.randrange(255)
    elif kind == 6:
        frame = frame[:10] + bytearray(dice.randbytes(len(frame) - 12)) + bytearray(dice.randbytes(2))
    else:
        frame[-2:] = dice.randbytes(2)
    return bytes(frame)


def is_sound(sample: Sample) -> bool:
    """Return True if somebody sent this row."""
    return abs(sample.voltage_V - VOLTAGE_V) < 1e-6 and abs(sample.current_A - CURRENT_A) < 1e-6


def good_frames(bench: Bench) -> list[bytes]:
    """Return frames as the vehicle sends them, two batteries first, then a heartbeat; the last is of MAVLink 1."""
    said: list[Any] = [battery_status(Sample(0.0, VOLTAGE_V, CURRENT_A, 25.0, 0.1), i) for i in (0, 1)]
    said += [heartbeat(True), dialect.MAVLink_sys_status_message(0, 0, 0, 0, 16000, 1200, 70, 0, 0, 0, 0, 0, 0)]
    said += [dialect.MAVLink_param_value_message(b"BATT_CAPACITY", 5000.0, 9, 1, 0)]
    old: Any = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    return [bench.framed(message) for message in said] + [bytes(said[0].pack(old, force_mavlink1=True))]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    dice, start_s = random.Random(args.seed), time.monotonic()
    options = PackOptions(capacity_Ah=5.0, cells=4)
    bench = Bench(options, feed=FeedSection(kinds=("named", "battery")))
    daemon, rewriter, slipped, forged, rows = bench.daemon, Rewriter(soc=True), [], [], 0
    step = daemon._step

    def watched(row: LiveRow, vehicle: Vehicle, now_s: float) -> None:
        nonlocal rows
        rows += 1
        if not is_sound(row.sample):
            slipped.append(row)
        step(row, vehicle, now_s)
        estimate = daemon.batteries.reports[row.instance].estimate
        if row.instance > 1 or not (estimate.voltage_V != estimate.voltage_V or is_sound(row.sample)):
            forged.append(estimate)

    daemon._step = watched  # type: ignore[method-assign]
    good = good_frames(bench)
    changed = sent_good = 0
    body = struct.pack(ESTIMATE_LAYOUT, 1, 1, 0, OK, 321.0, 0.5, bench.now_s)
    for k in range(args.frames // A_TURN):
        rewriter.take(body[:-8] + struct.pack("<d", bench.now_s))
        for _ in range(A_TURN):
            piece = mutated(dice, good)
            bench.link.incoming.append((piece, dice.randrange(3)))
            if rewriter.frame(piece, bench.now_s) != piece and framing.battery_of(piece) is None:
                changed += 1
            rewriter.datagram(piece, bench.now_s)
        if k % int(GOOD_EVERY_S * 100) == 0:
            bench.link.incoming += [(good[2], "fc"), (good[0], "fc")]
            sent_good += 1
        daemon.turn()
        bench.now_s += 0.01
    shown = {r.instance: r.at(bench.now_s) for r in daemon.board.reports}
    took_s = time.monotonic() - start_s
    print(f"{args.frames} damaged frames in {took_s:.0f} s: nothing raised; {daemon.board.counts['bad_checksums']} bad")
    print(f"{sent_good} good rows sent, {rows} taken in (a cut frame may be made whole by the piece behind it)")
    print(f"rows that nobody sent, with a good checksum: {len(slipped)}; estimates made of them: {len(forged)}")
    print(f"frames that the rewriter changed though they were damaged: {changed}")
    print(f"at the end battery 0: {shown[0].status}, soc {shown[0].soc:.3f}, {shown[0].remaining_s:.0f} s left")
    return 1 if changed or forged else 0


if __name__ == "__main__":
    sys.exit(main())

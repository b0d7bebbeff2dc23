"""Logs to time readers with: a 60 MB `.BIN` and a 36 MB `.tlog` of 35 message types, always the same bytes.

Both carry 30 000 battery rows (10 Hz for 50 minutes) among the traffic of a flight controller of today. The message
mix and rates are those of a copter at full logging; the values beside the battery's are noise.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

BATTERY_ROWS = 30_000
BATTERY_PERIOD_US = 100_000
# name, format, columns, records between two battery rows
DATAFLASH = (
    ("IMU", "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz", 10),
    ("ATT", "QccccCCCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF", 4),
    ("RATE", "Qffffffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut", 4),
    ("RCIN", "QHHHHHHHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8,C9,C10,C11,C12,C13,C14", 2),
    ("RCOU", "QHHHHHHHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8,C9,C10,C11,C12,C13,C14", 2),
    ("VIBE", "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip", 2),
    ("CTUN", "Qffffffefffhh", "TimeUS,ThI,ABst,ThO,ThH,DAlt,Alt,BAlt,DSAlt,SAlt,TAlt,DCRt,CRt", 1),
    ("BARO", "QBffcfIffB", "TimeUS,I,Alt,Press,Temp,CRt,SMS,Offset,GndTemp,Health", 2),
    ("MAG", "QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S", 2),
    ("GPS", "QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U", 1),
    ("XKF1", "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH", 2),
    ("XKF2", "QBccccchhhhhhfff", "TimeUS,C,AX,AY,AZ,VWN,VWE,MN,ME,MD,MX,MY,MZ,IDX,IDY,IS", 2),
    ("XKF3", "QBcccccchhhccff", "TimeUS,C,IVN,IVE,IVD,IPN,IPE,IPD,IMX,IMY,IMZ,IYAW,IVT,RErr,ErSc", 2),
    ("XKF4", "QBcccccfffHIHbB", "TimeUS,C,SV,SP,SH,SM,SVT,errRP,OFN,OFE,FS,TS,SS,GPS,PI", 2),
    ("PSCN", "Qffffffff", "TimeUS,TPN,PN,DVN,TVN,VN,DAN,TAN,AN", 1),
    ("PSCE", "Qffffffff", "TimeUS,TPE,PE,DVE,TVE,VE,DAE,TAE,AE", 1),
    ("PSCD", "Qffffffff", "TimeUS,TPD,PD,DVD,TVD,VD,DAD,TAD,AD", 1),
    ("MOTB", "Qfffff", "TimeUS,LiftMax,BatVolt,ThLimit,ThrAvMx,ThrOut", 1),
    ("ESC", "QBffffcfcB", "TimeUS,Instance,RPM,RawRPM,Volt,Curr,Temp,CTot,MotTemp,Err", 1),
    ("POWR", "QffHHB", "TimeUS,Vcc,VServo,Flags,AccFlags,Safety", 1),
)
RARE = tuple((f"R{n:03d}", "QIf", "TimeUS,A,B") for n in range(11))
LETTERS = {"c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "N": "16s", "n": "4s", "Z": "64s", "M": "B"}


def make_bin(path: Path, seed: int = 7) -> int:
    """Write the DataFlash log to `path`; return the number of records."""
    random = np.random.default_rng(seed)
    kinds = [("FMT", "BBnNZ", "Type,Length,Name,Format,Columns"), ("PARM", "QNf", "TimeUS,Name,Value")]
    kinds += [("BAT", "QBfffffcfB", "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct")]
    kinds += [k[:3] for k in DATAFLASH] + list(RARE)
    number = {name: 128 + i for i, (name, _, _) in enumerate(kinds)}
    body = {name: struct.Struct("<" + "".join(LETTERS.get(c, c) for c in chars)) for name, chars, _ in kinds}
    records = 0
    with path.open("wb") as file:
        for name, chars, labels in kinds:
            values = (number[name], body[name].size + 3, name.encode(), chars.encode(), labels.encode())
            file.write(b"\xa3\x95\x80" + body["FMT"].pack(*values))
        for name, value in (("BATT_CAPACITY", 5000.0), ("BATT_CRT_VOLT", 13.2), ("BATT_LOW_VOLT", 14.0)):
            file.write(b"\xa3\x95\x81" + body["PARM"].pack(0, name.encode(), value))
        traffic = [name for name, _, _, often in DATAFLASH for _ in range(often)]
        blocks = [_noise(random, body[n].size - 8) for n in traffic]
        heads = [b"\xa3\x95" + bytes([number[n]]) for n in traffic]
        steps_us = np.sort(random.integers(1, BATTERY_PERIOD_US, len(traffic))).tolist()
        records = len(kinds) + 3
        for row in range(BATTERY_ROWS):
            time_us = row * BATTERY_PERIOD_US
            for head, block, step_us in zip(heads, blocks, steps_us, strict=True):
                noise = block[row % len(block)]
                file.write(head + struct.pack("<Q", time_us + step_us) + noise)
            records += len(traffic) + 1
            if row % 100 == 0:
                name = RARE[row // 100 % len(RARE)][0]
                file.write(b"\xa3\x95" + bytes([number[name]]) + body[name].pack(time_us + BATTERY_PERIOD_US, row, 1.0))
                records += 1
            volts, amps, used_mAh = _battery(row)
            its = (time_us + BATTERY_PERIOD_US, 0, volts, volts, amps, used_mAh, 0.0, 2500 + row % 900, 0.01, 50)
            file.write(b"\xa3\x95" + bytes([number["BAT"]]) + body["BAT"].pack(*its))
    return records


def make_tlog(path: Path, seed: int = 7, rows: int = BATTERY_ROWS, per_row: int = 26) -> int:
    """Write the telemetry log to `path`; return the number of frames."""
    frames = 0
    pool = _pool(seed)
    with path.open("wb") as file:
        for row in range(rows):
            time_us = 1_700_000_000_000_000 + row * BATTERY_PERIOD_US
            for k in range(per_row):
                file.write(struct.pack(">Q", time_us + k * (BATTERY_PERIOD_US // (per_row + 1))))
                file.write(pool[(row * per_row + k) % len(pool)])
            file.write(struct.pack(">Q", time_us + BATTERY_PERIOD_US - 8))
            file.write(_battery_frame(row))
            frames += per_row + 1
    return frames


def _battery(row: int) -> tuple[float, float, float]:
    """Return volts, amperes and used mAh of one row."""
    share = row / BATTERY_ROWS
    return 16.6 - 3.2 * share - 0.1 * (row % 7) / 7, 12.0 + (row % 50) / 10, 4800.0 * share


def _noise(random: np.random.Generator, size: int) -> list[bytes]:
    return [random.integers(0, 256, size, np.uint8).tobytes() for _ in range(61)]


def _link(seed: int = 0) -> Any:
    from pymavlink.dialects.v20 import ardupilotmega

    link = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    link.seq = seed % 256
    return link


def _battery_frame(row: int) -> bytes:
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    volts, amps, used_mAh = _battery(row)
    message = dialect.MAVLink_battery_status_message(
        0, 0, 1, 2500 + row % 900, [round(volts * 1000)] + [65535] * 9, round(amps * 100), round(used_mAh), -1, 50
    )
    return bytes(message.pack(_link(row)))


def _pool(seed: int) -> list[bytes]:
    """Return whole frames of 34 other types, 29 variants each, mixed; heartbeats of an autopilot."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    random = np.random.default_rng(seed)
    names = "ATTITUDE GLOBAL_POSITION_INT GPS_RAW_INT RAW_IMU SCALED_IMU2 SCALED_IMU3 SCALED_PRESSURE RC_CHANNELS "
    names += "SERVO_OUTPUT_RAW VFR_HUD MISSION_CURRENT NAV_CONTROLLER_OUTPUT POWER_STATUS MEMINFO SYSTEM_TIME AHRS "
    names += "AHRS2 HWSTATUS TERRAIN_REPORT EKF_STATUS_REPORT VIBRATION LOCAL_POSITION_NED ATTITUDE_QUATERNION WIND "
    names += "RANGEFINDER ESC_TELEMETRY_1_TO_4 PARAM_REQUEST_READ TIMESYNC SCALED_PRESSURE2 POSITION_TARGET_GLOBAL_INT "
    names += "HOME_POSITION EXTENDED_SYS_STATE"
    found: list[bytes] = []
    ids = {kind.msgname: number for number, kind in dialect.mavlink_map.items()}
    for variant in range(29):
        link = _link(variant)
        found.append(bytes(dialect.MAVLink_heartbeat_message(2, 3, 128, 0, 4, 3).pack(link)))
        status = dialect.MAVLink_sys_status_message(0, 0, 0, 0, 15000, 1200, 50, 0, 0, 0, 0, 0, 0)
        found.append(bytes(status.pack(link)))
        for name in names.split():
            kind = dialect.mavlink_map[ids[name]]
            payload = random.integers(0, 256, kind.unpacker.size, np.uint8).tobytes()
            found.append(_frame(payload, kind, ids[name], variant))
    return found


def _frame(payload: bytes, kind: Any, number: int, sequence: int) -> bytes:
    """A MAVLink 2 frame of system 1, component 1 around any payload."""
    from pymavlink.generator.mavcrc import x25crc

    payload = payload.rstrip(b"\0") or b"\0"
    head = bytes([len(payload), 0, 0, sequence, 1, 1]) + number.to_bytes(3, "little")
    crc: int = x25crc(head + payload + bytes([kind.crc_extra])).crc
    return b"\xfd" + head + payload + crc.to_bytes(2, "little")

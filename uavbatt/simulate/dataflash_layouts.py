"""The DataFlash records that are written here, each as its FMT record describes it.

Letters: B, H, I, Q unsigned, M int8, h int16, i int32, f float; c int16 and e int32 in hundredths, L int32 in 1e-7
degrees; n, N, Z 4, 16, 64 characters. Source: ArduPilot AP_Logger/LogStructure.h.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

HEAD = b"\xa3\x95"
STRUCT_OF = {
    "B": "B", "H": "H", "I": "I", "Q": "Q", "M": "b", "c": "h", "e": "i", "L": "i", "f": "f",
    "n": "4s", "N": "16s", "Z": "64s",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class MessageLayout:
    """A MessageLayout describes one record type: its number, name, format letters and column names."""

    type: int
    name: str
    format: str
    columns: str

    @property
    def body(self) -> struct.Struct:
        """Return the packed layout of the body, which follows the three header bytes."""
        return struct.Struct("<" + "".join(STRUCT_OF[letter] for letter in self.format))

    def record(self, *values: bytes | float) -> bytes:
        """Return one whole record: the header, and `values` in the order of the columns."""
        return HEAD + bytes([self.type]) + self.body.pack(*values)


FMT = MessageLayout(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
PARM = MessageLayout(129, "PARM", "QNf", "TimeUS,Name,Value")
ARM = MessageLayout(130, "ARM", "QBIBB", "TimeUS,ArmState,ArmChecks,Forced,Method")
EV = MessageLayout(131, "EV", "QB", "TimeUS,Id")
BAT = MessageLayout(132, "BAT", "QBfffffcfB", "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct")
LAYOUTS = (FMT, PARM, ARM, EV, BAT)

_COMMAND = ("QHHHffffLLfB", "TimeUS,CTot,CNum,CId,Prm1,Prm2,Prm3,Prm4,Lat,Lng,Alt,Frame")
MSG = MessageLayout(133, "MSG", "QZ", "TimeUS,Message")
MODE = MessageLayout(134, "MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn")
CMD = MessageLayout(135, "CMD", *_COMMAND)
MISE = MessageLayout(136, "MISE", *_COMMAND)
ORGN = MessageLayout(137, "ORGN", "QBLLe", "TimeUS,Type,Lat,Lng,Alt")
POS = MessageLayout(138, "POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt")
GPS = MessageLayout(139, "GPS", "QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U")
XKF2 = MessageLayout(140, "XKF2", "QBcc", "TimeUS,C,VWN,VWE")
ROUTE_LAYOUTS = (MSG, MODE, CMD, MISE, ORGN, POS, GPS, XKF2)

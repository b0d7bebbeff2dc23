"""The ledger's tables, and the migrations from older versions.

    packs      one row a pack: its size, and its outlook after the last flight
    flights    one row a flight: the log, the charge drawn, the evidence of the flight, the belief after it
    airborne   one row a flight that has not landed yet
    rows       the telemetry of such a flight, which a crash before the landing would lose

PRAGMA user_version counts the migrations done; a ledger of a newer version is not touched.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path

from uavbatt.errors import BadInput

APPLICATION_ID = 0x75625061  # "ubPa": told by `file` and by PRAGMA application_id

FIRST = """
CREATE TABLE packs (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    cells INTEGER NOT NULL,
    rated_Ah REAL NOT NULL,
    type_ohm REAL NOT NULL,
    flights INTEGER NOT NULL,
    last_utc_s REAL,
    capacity_Ah REAL NOT NULL, capacity_lo_Ah REAL NOT NULL, capacity_hi_Ah REAL NOT NULL,
    resistance_ohm REAL NOT NULL, resistance_lo_ohm REAL NOT NULL, resistance_hi_ohm REAL NOT NULL,
    capacity_trend REAL NOT NULL, capacity_trend_sd REAL NOT NULL,
    resistance_trend REAL NOT NULL, resistance_trend_sd REAL NOT NULL,
    retire_flights REAL, retire_lo_flights REAL, retire_hi_flights REAL,
    findings TEXT NOT NULL
);
CREATE TABLE flights (
    id INTEGER PRIMARY KEY,
    pack INTEGER NOT NULL REFERENCES packs(id) ON DELETE CASCADE,
    key TEXT NOT NULL,
    start_utc_s REAL, duration_s REAL, source TEXT NOT NULL,
    battery TEXT NOT NULL, battery_sha256 TEXT NOT NULL,
    cells INTEGER NOT NULL, rated_Ah REAL NOT NULL, type_ohm REAL NOT NULL,
    soc_start REAL, soc_end REAL, charge_Ah REAL, energy_Wh REAL, temp_mean_C REAL, temp_max_C REAL,
    weak_cell INTEGER NOT NULL, weak_cell_V REAL, cycles INTEGER,
    told_log_ohm REAL NOT NULL, told_log_Ah REAL NOT NULL,
    told_variance_ohm REAL NOT NULL, told_variance_Ah REAL NOT NULL, told_covariance REAL NOT NULL,
    known_log_ohm REAL, known_log_Ah REAL, known_ohm_trend REAL, known_Ah_trend REAL, known_covariance TEXT,
    findings TEXT NOT NULL
);
CREATE UNIQUE INDEX flights_of_pack ON flights(pack, key);
"""

AIRBORNE = """
CREATE TABLE airborne (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    start_utc_s REAL,
    cells INTEGER NOT NULL, capacity_Ah REAL NOT NULL,
    cycles INTEGER
);
CREATE TABLE rows (
    flight INTEGER NOT NULL REFERENCES airborne(id) ON DELETE CASCADE,
    time_s REAL NOT NULL, voltage_V REAL NOT NULL, current_A REAL, temp_C REAL,
    PRIMARY KEY (flight, time_s)
) WITHOUT ROWID;
"""

KIND_OF_CELLS = """
ALTER TABLE flights ADD COLUMN fullest_cell_V REAL;
ALTER TABLE flights ADD COLUMN known_fullest_cell_V REAL;
"""

MIGRATIONS = (FIRST, AIRBORNE, KIND_OF_CELLS)


def version(connection: sqlite3.Connection) -> int:
    """Return how many migrations were done on the ledger; 0 for an empty file."""
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def check_schema(connection: sqlite3.Connection, path: Path) -> int:
    """Return the ledger's version. Raises BadInput for another database, or a ledger of a later version."""
    owner = int(connection.execute("PRAGMA application_id").fetchone()[0])
    now = version(connection)
    is_empty = now == 0 and owner == 0 and connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0] == 0
    if owner != APPLICATION_ID and not is_empty:
        raise BadInput(path, "", "a pack ledger, found another SQLite database")
    if now > len(MIGRATIONS):
        raise BadInput(path, "", f"a pack ledger of version {len(MIGRATIONS)}, found {now}: update uavbatt")
    return now


def migrate(connection: sqlite3.Connection) -> None:
    """Apply the migrations that are left; the connection must hold the write lock, so that all are done or none."""
    for step in range(version(connection), len(MIGRATIONS)):
        for statement in filter(str.strip, MIGRATIONS[step].split(";")):
            connection.execute(statement)
        connection.execute(f"PRAGMA user_version = {step + 1}")
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")

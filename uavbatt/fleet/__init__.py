"""Many flights at once: each log becomes one row of a table; a page shows packs and forecasts.

    logs.py       finds the logs, on a disk or at any fsspec address, and reads their bytes
    row.py        the columns of a row
    fly.py        one log -> one row; if the log cannot be replayed, the row has the reason
    lesson.py     one log -> the record of its flight for the pack ledger; ledger.py fills the ledger with all of them
    errand.py     the work on one log, as it is sent to a worker
    journal.py    rows on disk as they come, so that a stopped run can go on
    tables.py     journal -> Parquet and CSV, piece by piece
    processes.py  the workers on this machine; cluster.py those of a Dask cluster
    run.py        the run over all logs, with a bounded number of them under way

Needs the extra `fleet`, which is imported only when a run begins.
"""

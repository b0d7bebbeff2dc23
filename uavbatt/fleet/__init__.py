"""Many flights at once: each log becomes one row, the rows a table, the table a page about packs and forecasts.

    logs.py       which logs there are, on a disk or behind any fsspec address, and their bytes
    row.py        what is told of one flight, column by column
    fly.py        one log -> one row; whatever is wrong with the log becomes the row's reason
    lesson.py     one log -> what its flight says of its pack; ledger.py the pack ledger that all of them fill
    errand.py     a log and what a worker makes of it
    journal.py    rows on disk as they come, so that a stopped run goes on where it was
    tables.py     the journal -> Parquet and CSV, piece by piece
    processes.py  the workers on this machine; cluster.py those of a Dask cluster
    run.py        the run over them, a bounded number of logs under way

Needs the extra `fleet`; nothing of it is imported before a run begins.
"""

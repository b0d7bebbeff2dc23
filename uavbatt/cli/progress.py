"""A progress bar on stderr, if that is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from uavbatt.errors import terminal_line

MEMORY_S = 600.0  # the speed is a mean over this time: one step may take a minute on a small computer


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[float], None]]:
    """Show a bar with the time left while the block runs, if stderr is a terminal.

    The block gets a function, and calls it with each share of the work that is done; the shares add up to 1.
    """
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, speed_estimate_period=MEMORY_S) as bar:
        task = bar.add_task(terminal_line(title), total=1.0)
        yield lambda share: bar.advance(task, share)

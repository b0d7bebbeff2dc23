"""A progress bar on stderr for work that reports its shares; nothing where nobody watches."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from uavbatt.errors import terminal_line

MEMORY_S = 600.0  # over which the speed is judged: single steps may take a minute on a small computer


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[float], None]]:
    """Show a bar with the time left while the block runs, when stderr is a terminal.

    The block calls what it is given with the share of the work just done; the shares add up to 1.
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

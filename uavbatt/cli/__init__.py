"""The command line: one command a file. Data on stdout or in the named file, everything else on stderr."""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class _Ended(BaseException):
    """_Ended says that a signal ends the process, by its number."""


def _end(number: int, _: object) -> None:
    raise _Ended(number)


@contextmanager
def _endings() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the block by an exception, which removes the files that are not written to their end.

    A signal that is ignored (nohup) stays ignored.
    """
    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]  # Windows has no SIGHUP
    is_ours = threading.current_thread() is threading.main_thread()
    taken = [n for n in (getattr(signal, name) for name in names) if is_ours and signal.getsignal(n) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, _end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def main() -> None:
    """Run `uavbatt`; an error ends it with one line and the exit code of that error."""
    # The matrices are small: a second thread of the linear algebra only slows the first one down.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    gc.set_threshold(50_000)  # rows have no reference cycles, and the search for some took a seventh of a replay
    if isinstance(sys.stdout, io.TextIOWrapper):  # an ASCII stream gets escapes instead of other letters
        sys.stdout.reconfigure(errors="backslashreplace")
    from uavbatt.cli.app import app
    from uavbatt.cli.usage import run
    from uavbatt.errors import UavbattError, terminal_line

    try:
        with _endings():
            sys.exit(run(app, sys.argv[1:]))
    except UavbattError as error:
        print(terminal_line(f"uavbatt: {error}"), file=sys.stderr)
        sys.exit(error.exit_code)
    except UnicodeEncodeError as error:  # an argument in another encoding: no file, page or ledger can hold it
        found = error.object[max(error.start - 40, 0) : error.end + 40]
        print(terminal_line(f"uavbatt: {found}: expected text in UTF-8"), file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # `uavbatt ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:  # a full disk, a file without permission to read
        what = f"uavbatt: {error.filename or 'input or output'}: {error.strerror or error}"
        print(terminal_line(what), file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("uavbatt: interrupted", file=sys.stderr)
        sys.exit(130)
    except _Ended as end:
        print(f"uavbatt: ended by {signal.Signals(end.args[0]).name}", file=sys.stderr)
        sys.exit(128 + end.args[0])

"""Host names -> addresses, in a thread beside a loop that must not wait."""

from __future__ import annotations

import errno
import socket
import threading


class Resolver:
    """Resolver finds the address of a host in a thread of its own, so that nobody waits for a slow name server."""

    def __init__(self, host: str) -> None:
        self._host = host
        self._thread: threading.Thread | None = None
        self._found: str | OSError | None = None

    def address(self) -> str | None:
        """Return the address; None while it is looked for. Raises OSError if not found; the next call looks anew."""
        if _is_address(self._host):
            return self._host
        if self._thread is None:
            self._thread = threading.Thread(target=self._look, name="resolver", daemon=True)
            self._thread.start()
        if self._thread.is_alive():
            return None
        self._thread, found = None, self._found
        if isinstance(found, OSError):
            raise found
        return found

    def _look(self) -> None:
        try:
            self._found = socket.gethostbyname(self._host)
        except (OSError, UnicodeError) as error:  # a label of more than 63 characters is no host name
            self._found = error if isinstance(error, OSError) else OSError(errno.EINVAL, str(error))


def _is_address(host: str) -> bool:
    try:
        socket.inet_aton(host)
    except OSError:
        return False
    return True

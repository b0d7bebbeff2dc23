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
            self._found = address_of(self._host)
        except OSError as error:
            self._found = error


def address_of(host: str) -> str:
    """Return the address of a host, IPv4 if it has one; waits for the name server. Raises OSError if not found."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_DGRAM)
    except UnicodeError as error:  # a label of more than 63 characters is no host name
        raise OSError(errno.EINVAL, str(error)) from None
    return str(min(found, key=lambda info: info[0] != socket.AF_INET)[4][0])


def family_of(address: str) -> socket.AddressFamily:
    """Return the family of sockets that reach an address."""
    return socket.AF_INET6 if ":" in address else socket.AF_INET


def _is_address(host: str) -> bool:
    if ":" in host:
        return True
    try:
        socket.inet_aton(host)
    except OSError:
        return False
    return True

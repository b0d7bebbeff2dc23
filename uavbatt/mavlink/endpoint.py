"""Endpoint strings, spelled as in pymavlink, and the interface of an open endpoint.

udpin:HOST:PORT (or udp:)   listen; answers go to everybody heard in the last minute
udpout:HOST:PORT            send there, hear answers
tcp:HOST:PORT               connect; tcpin:HOST:PORT accepts any number of clients
HOST is a name, an IPv4 address, or an IPv6 address in brackets: udpin:[::1]:14550.
DEVICE[,BAUD] or serial:DEVICE:BAUD     a serial line, 57600 baud unless said
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

from uavbatt.errors import UsageError

DEFAULT_BAUD = 57_600

Chunk = tuple[bytes, object]  # bytes, and who sent them


class Endpoint(NamedTuple):
    """Endpoint is an endpoint string, taken apart."""

    kind: str  # udpin | udpout | tcp | tcpin | serial
    host: str  # or the device
    port: int  # or the baud rate
    text: str


class Link(Protocol):
    """Link is the interface of an open endpoint."""

    is_stream: bool
    problem: str  # why it is not open, in words; empty while it is

    def filenos(self) -> Iterator[int]:
        """Yield the descriptors to wait on."""

    def read(self, now_s: float) -> list[Chunk]:
        """Return all that has come in, each chunk with its sender; `now_s` is a monotonic clock [s]."""

    def write(self, data: bytes, now_s: float) -> None:
        """Send without waiting; what cannot be sent, or would come late, is lost."""

    def close(self) -> None:
        """Release the sockets."""


def unusable(at: Endpoint, error: OSError) -> UsageError:
    """Return the error that names an endpoint and why the system refuses it."""
    return UsageError(f"endpoint `{at.text}`: {error.strerror or error}")


def parse(text: str) -> Endpoint:
    """Return an endpoint string taken apart. Raises UsageError that says what was expected."""
    forms = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or DEVICE,BAUD"
    expected = f"endpoint `{text}`: expected {forms}"
    kind, _, rest = text.partition(":")
    if kind == "udp":
        kind = "udpin"
    if kind in ("udpin", "udpout", "tcp", "tcpin"):
        host, _, port = rest.removeprefix("//").rpartition(":")
        if not host or not port.isdigit() or not 0 < int(port) < 65536:
            raise UsageError(expected)
        is_bracketed = host.startswith("[") and host.endswith("]")
        if is_bracketed is not (":" in host):
            raise UsageError(f"{expected}; an IPv6 address stands in brackets, as in udpin:[::1]:14550")
        return Endpoint(kind, host.strip("[]"), int(port), text)
    if kind == "serial":
        device, _, baud = rest.rpartition(":")
    else:
        device, _, baud = text.partition(",")
    baud = baud or str(DEFAULT_BAUD)
    if not device.startswith("/") or not baud.isdigit():
        raise UsageError(expected)
    return Endpoint("serial", device, int(baud), text)

"""sd_notify: messages to the service manager, if there is one."""

from __future__ import annotations

import os
import socket


def notify(message: str) -> None:
    """Send systemd a message, e.g. READY=1, WATCHDOG=1 or STATUS=text; do nothing without $NOTIFY_SOCKET."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as manager:
            manager.setblocking(False)
            manager.connect("\0" + address[1:] if address.startswith("@") else address)
            manager.send(message.encode())
    except OSError:
        return

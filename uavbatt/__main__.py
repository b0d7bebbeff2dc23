"""`python -m uavbatt` is the command `uavbatt`."""

from __future__ import annotations

from uavbatt.cli import main

if __name__ == "__main__":
    main()

"""Fixtures for all tests. The measured data are not part of the repository."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of measured data: $UAVBATT_DATA, else `../shared/data` beside the checkout."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("UAVBATT_DATA", default))
    if not folder.is_dir():
        pytest.skip("the measured data are not here: set UAVBATT_DATA to their folder")
    return folder

"""Fixtures that every test may use."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recorded data that lies beside the checkout."""
    if not SHARED_DATA.is_dir():
        pytest.skip("recorded data (shared/data beside the checkout) is absent")
    return SHARED_DATA

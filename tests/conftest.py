"""Fixtures that every test may use, and the check of array shapes while tests run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest
from hypothesis import HealthCheck, settings

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

CHECKER = "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"
"""The checker of annotations; an int is a float here, as in PEP 484."""


# A busy machine is no finding: examples are counted, not timed.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


def pytest_configure(config: pytest.Config) -> None:
    """Check every annotation of the packages, array shapes included, whenever one of their functions runs.

    Not while benchmarks run, and not in processes that a test starts: these have the packages as a user
    has them.
    """
    if not config.getoption("benchmark_only"):
        jaxtyping.install_import_hook(["hilbrace", "fabrication", "evaluation"], CHECKER)


@pytest.fixture(autouse=True)
def _annotations(request: pytest.FixtureRequest) -> Iterator[None]:
    """Let tests marked ``malformed`` give the library what its annotations forbid."""
    malformed = request.node.get_closest_marker("malformed") is not None
    jaxtyping.config.update("jaxtyping_disable", malformed)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recorded data that lies beside the checkout."""
    if not SHARED_DATA.is_dir():
        pytest.skip("recorded data (shared/data beside the checkout) is absent")
    return SHARED_DATA


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whole runs first: the last file should not keep one of two processes waiting."""
    long = {"pipeline": 0, "gallery": 1}
    items.sort(key=lambda item: long.get(item.path.parent.name, 2))

"""Products in blocks: the same numbers, whatever the block, and the same bits every time."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.shell.blocks import times, transposed_times


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 5000), st.integers(0, 20), st.integers(0, 20), st.booleans(), st.integers(0, 1000))
def test_blocks_give_the_product(rows, one, other, by_columns, seed):
    rng = np.random.default_rng(seed)
    order = "F" if by_columns else "C"
    left = np.asarray(rng.standard_normal((rows, one)), order=order)
    right, tall = rng.standard_normal((one, other)), rng.standard_normal((rows, other))
    np.testing.assert_allclose(times(left, right), left @ right, atol=1e-12)
    np.testing.assert_allclose(transposed_times(left, tall), left.T @ tall, atol=1e-10)
    assert times(left, right).tobytes() == times(left, right).tobytes()

"""All that the design loop carries from one iteration to the next, saved and read back bit for bit."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from hilbrace.errors import InputError
from hilbrace.optimize.objective import Reference
from hilbrace.run.records import load

Array = np.ndarray

_NOISE_STREAM = 1
"""The generator of the noise is another one than that of the first parameters."""


@dataclass(frozen=True)
class Progress:
    """The state of the loop between two iterations.

    Attributes:
        key: Key of the stage that this belongs to.
        iteration: Iterations done.
        theta: Parameters of the field.
        bias: Level of the field.
        momentum: First and second moments of Adam: theta's, then the bias's, flattened.
        generator: State of the random generator that the noise on the gradient is drawn from, as JSON.
        firm: The segmentation: True is firm.
        history: Normalised L1..L5 and total, one row per iteration.
        trace: What else is told of every iteration, columns as `hilbrace.optimize.history.TRACE`.
        film: Design variable at the cut vertices in the snapshots so far, 0 to 255.
        film_iterations: Iterations done before each snapshot.
        losses_initial: L1..L5 of the first field.
        measure: L1..L5 by which losses are divided, see `objective.Reference`; zero before the first.
        uniform: L1's preserved sum and relief of the uniform brace [rad^2].
        support: Stiffness of the uniform brace about the prevented angles in each posture [N*m/rad].
        plain: Stiffness of the uniform brace about the three angles at rest [N*m/deg].
    """

    key: str
    iteration: int
    theta: Float[Array, "*layer"]
    bias: Float[Array, ""]
    momentum: Float[Array, "2 parameter"]
    generator: str
    firm: Bool[Array, " triangle"]
    history: Float[Array, "iteration term"]
    trace: Float[Array, "iteration column"]
    film: UInt8[Array, "snapshot cut_vertex"]
    film_iterations: Int[Array, " snapshot"]
    losses_initial: Float[Array, " loss"]
    measure: Float[Array, " loss"]
    uniform: Float[Array, "2"]
    support: Float[Array, "posture angle"]
    plain: Float[Array, "3"]

    def tensors(self) -> tuple[Float[Tensor, "*layer"], Float[Tensor, ""]]:
        """Parameters and level as tensors of their own."""
        return torch.from_numpy(self.theta.copy()), torch.from_numpy(np.array(self.bias))

    def flat(self) -> Float[Array, " parameter"]:
        """Parameters and level in the order of the moments."""
        return np.append(self.theta.ravel(), self.bias)


def resumed(checkpoint: Path, key: str) -> Progress | None:
    """The checkpoint's state, if it is whole and belongs to this stage.

    Args:
        checkpoint: File of the checkpoint, which need not exist.
        key: Key of the stage.
    """
    if not checkpoint.exists():
        return None
    try:
        state = load(Progress, checkpoint)
    except InputError:
        return None
    return state if state.key == key else None


def measure_of(state: Progress) -> Reference:
    """What the losses of a begun loop are measured by."""
    preserved, relieved = map(float, state.uniform)
    return Reference(state.measure, preserved, relieved, state.support)


def first_generator(seed: int) -> str:
    """State of the noise's generator at the start of a run, as JSON."""
    return json.dumps(np.random.default_rng([seed, _NOISE_STREAM]).bit_generator.state)


def drawn(generator: str, count: int) -> tuple[Float[Array, " draw"], str]:
    """Draw from the normal distribution.

    Args:
        generator: State of the generator, as JSON.
        count: Number of draws.

    Returns:
        The draws, and the state after them.
    """
    source = np.random.default_rng(0)
    source.bit_generator.state = json.loads(generator)
    draws = source.standard_normal(count)
    return draws, json.dumps(source.bit_generator.state)


def quantised(d: Float[Array, " cut_vertex"]) -> UInt8[Array, " cut_vertex"]:
    """A design variable in [0, 1] in steps of 1/255, as films keep it."""
    return np.round(255.0 * np.clip(d, 0.0, 1.0)).astype(np.uint8)

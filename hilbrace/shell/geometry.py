"""Which shape of the brace stands for which frame of the motion.

The sparsity of the stiffness is the same in every shape, but each needs a factorisation of its own. `rest`
takes the rest shape for all frames, `frame` the posed shape of each, and `clusters:k` the k frames that stand
best for the others. On the tube of the benchmark (10k triangles, 45 frames, bent by up to 75 degrees), whose
compliance is off by 61 % on average if it keeps its rest shape, 5 shapes leave 3 % (at worst 14 %), 9 leave
2 % (11 %) and 15 leave 0.3 % (1.8 %).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import ConfigError, GeometryError
from hilbrace.shell.model import ShellModel, pose_shell
from hilbrace.shell.pool import side_by_side

Array = np.ndarray

_ROUNDS = 100
"""Most rounds of k-means; it ends after a few, when no frame moves."""


@dataclass(frozen=True)
class GeometryMode:
    """How shapes are given to frames.

    Attributes:
        kind: One shape for all frames, one for each cluster of frames, or one for each frame.
        clusters: Number of clusters; 0 for the other kinds.
    """

    kind: Literal["rest", "clusters", "frame"]
    clusters: int = 0


@dataclass(frozen=True)
class ShellFamily:
    """Shapes of one brace, and which of them stands for which frame.

    Memory: a shape of 10k triangles takes 11.7 MB, so that 45 of them take 0.53 GB; factors are not kept. A
    response adds the displacements that its gradient needs, 2.6 MB in each shape that has one frame.

    Attributes:
        shells: The shapes; their numbering is one and the same.
        shape_of_frame: Index of the shape of each frame; every shape has a frame.
    """

    shells: tuple[ShellModel, ...]
    shape_of_frame: Int[Array, " frame"]


def geometry_mode(text: str, key: str = "optimize.geometry") -> GeometryMode:
    """Read ``rest``, ``clusters:k`` (k a number from 1) or ``frame``.

    Args:
        text: The setting.
        key: Its name in the configuration, for the error.

    Raises:
        ConfigError: It is none of these.
    """
    if text == "rest":
        return GeometryMode("rest")
    if text == "frame":
        return GeometryMode("frame")
    match = re.fullmatch(r"clusters:([1-9][0-9]{0,3})", text)
    if match is None:
        raise ConfigError(
            f"no geometry is named '{text}'",
            where=key,
            hint="choose rest, frame, or clusters:k with the number k of shapes, such as clusters:9",
        )
    return GeometryMode("clusters", int(match[1]))


def shell_family(
    rest: ShellModel, posed: Float[Array, "frame vertex 3"], mode: GeometryMode, threads: int = 1
) -> ShellFamily:
    """The shapes that a geometry mode wants.

    Args:
        rest: The shell in its rest shape.
        posed: Vertices in every frame [mm].
        mode: How shapes are given to frames. More clusters than frames are as many as frames.
        threads: Threads that build shapes side by side.

    Raises:
        GeometryError: A frame's shape is not finite, has folds or triangles without area; the frame is named.
    """
    frames = len(posed)
    _check_posed(posed)
    if mode.kind == "rest":
        return ShellFamily((rest,), np.zeros(frames, dtype=np.int64))
    if mode.kind == "frame" or mode.clusters >= frames:
        chosen, shape_of_frame = np.arange(frames), np.arange(frames)
    else:
        chosen, shape_of_frame = cluster_frames(posed, mode.clusters)
    shells = side_by_side([partial(_posed, rest, posed[frame], frame) for frame in chosen.tolist()], threads)
    return ShellFamily(tuple(shells), shape_of_frame)


def cluster_frames(
    posed: Float[Array, "frame vertex 3"], clusters: int
) -> tuple[Int[Array, " cluster"], Int[Array, " frame"]]:
    """Group frames of similar shape by k-means on the vertices.

    Deterministic: the first seed is the frame nearest to the mean of all, each further one the frame farthest
    from the seeds before it (Gonzalez 1985, "Clustering to minimize the maximum intercluster distance"); ties
    go to the earlier frame.

    Args:
        posed: Vertices in every frame [mm].
        clusters: Number of clusters, at most that of the frames.

    Returns:
        The frame that stands for each cluster, the nearest to its mean, ascending; and the cluster of each
        frame. Frames of equal shape share a cluster, so that there may be fewer clusters than asked for.
    """
    flat = posed.reshape(len(posed), -1)
    centred = flat - flat.mean(axis=0)
    gram = centred @ centred.T
    between = np.maximum(np.diag(gram)[:, None] + np.diag(gram) - 2.0 * gram, 0.0)
    np.fill_diagonal(between, 0.0)
    label = between[:, _seeds(between, np.diag(gram), clusters)].argmin(axis=1)
    for _ in range(_ROUNDS):
        moved = _to_means(between, label).argmin(axis=1)
        if np.array_equal(moved, label):
            break
        label = moved
    _, label = np.unique(label, return_inverse=True)
    to_mean = _to_means(between, label)
    own = np.where(label[:, None] == np.arange(label.max() + 1), to_mean, np.inf)
    nearest = own.argmin(axis=0)
    order = np.argsort(nearest, kind="stable")
    return nearest[order], np.argsort(order, kind="stable")[label]


def _seeds(
    between: Float[Array, "frame frame"], from_mean: Float[Array, " frame"], clusters: int
) -> list[int]:
    seeds = [int(from_mean.argmin())]
    while len(seeds) < clusters:
        away = between[:, seeds].min(axis=1)
        if not away.max() > 0.0:
            break
        seeds.append(int(away.argmax()))
    return seeds


def _to_means(between: Float[Array, "frame frame"], label: Int[Array, " frame"]) -> Array:
    """Squared distance of every frame to the mean of every cluster, from those between the frames."""
    member = (label[:, None] == np.arange(label.max() + 1)).astype(float)
    count = member.sum(axis=0)
    share = member / np.where(count > 0, count, 1.0)
    inside = 0.5 * np.einsum("fk,fg,gk->k", share, between, share)
    return np.where(count > 0, between @ share - inside, np.inf)


def _check_posed(posed: Float[Array, "frame vertex 3"]) -> None:
    """One frame that is not finite would draw all others into its cluster."""
    if not len(posed):
        raise GeometryError(
            "the motion has no frames", where="posed shapes of the shell", hint="give one frame or more"
        )
    lost = np.flatnonzero(~np.isfinite(posed).all(axis=(1, 2)))
    if lost.size:
        raise GeometryError(
            f"vertices have no finite position in {lost.size} frames",
            where=f"frame {lost[0]}",
            hint="check the frame of the motion that posed the surface",
        )


def _posed(rest: ShellModel, vertices: Float[Array, "vertex 3"], frame: int) -> ShellModel:
    try:
        return pose_shell(rest, vertices)
    except GeometryError as fault:
        raise GeometryError(fault.what, where=f"frame {frame}, {fault.where}", hint=fault.hint) from fault

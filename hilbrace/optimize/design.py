"""The record that leaves the optimizer: the field, what it means, and how it was reached."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

Array = np.ndarray

LOSSES = ("joint_stability", "elastic_energy", "compliance", "volume", "seam")
"""L1..L5 of the paper's loss table, in order."""

COUPLINGS = ("stiffness", "paper")
"""Order of the coupling axis; see `hilbrace.optimize.coupling`."""


@dataclass(frozen=True)
class Design:
    """An optimized distribution of the design variable on the domain.

    Attributes:
        seed: Seed of the run.
        iterations: Iterations done.
        solver: Library that solved the shell.
        shapes: Shapes in which the frames' loads acted.
        parameters: Free parameters of the field: the weights of the Gaussians before the hyperplane, rows
            along u; or those of a network, flat.
        d_triangle: Design variable at triangle centres, in [0, 1] [-].
        d_vertex: Design variable at the cut vertices [-].
        width_triangle: Cell-space strut half width (``f_cell <= width``) at triangle centres [-].
        width_vertex: The same at the cut vertices [-].
        youngs_modulus: Effective modulus per triangle [MPa].
        volume_fraction_triangle: Volume fraction per triangle [-].
        firm_triangle: Segmentation, 1 firm and 0 soft, smoothed [-].
        firm_vertex: The same at the closed mesh's vertices [-].
        rim: Triangles that stay solid.
        energy_density: Worst elastic energy density over the motion for unit modulus, per triangle [-].
        pulls: How much each weighted loss wants a triangle firmer, see `hilbrace.optimize.pulls` [-].
        history: Loss terms per iteration, normalised, columns as `LOSSES`, last column the total.
        trace: What else is told of every iteration, columns as `hilbrace.optimize.history.TRACE`.
        film: Design variable at the cut vertices in the snapshots of the loop, 0 to 255.
        film_iterations: Iterations done before each snapshot.
        losses_initial: Unnormalised L1..L5 of the first iteration.
        losses_final: Unnormalised L1..L5 of the last.
        stiffness: Brace stiffness about (flexion, adduction, rotation) [N*m/deg].
        stiffness_uniform: The same for a uniform design of the same volume [N*m/deg].
        stiffness_flexions: Flexion of the postures in which the stiffness was evaluated [rad].
        stiffness_posed: Stiffness about (flexion, adduction, rotation) in each posture [N*m/deg].
        stiffness_posed_uniform: The same for the uniform design [N*m/deg].
        stiffness_by_energy: Stiffness about flexion that the energy of a small flexion gives [N*m/deg].
        moment_flexions: Flexions of the moment curves [rad], see `hilbrace.optimize.flexion_moment`.
        moment_held: Moment against flexion of a brace that follows the skin everywhere, of the design and of
            the uniform one [N*m].
        moment_free: The same of a brace that is held at its edges alone [N*m].
        coupling: Name of the coupling that the design was optimized with.
        angle_changes: Predicted change of the joint's three angles per frame [rad], by every coupling in the
            order of `COUPLINGS`; a model's prediction, not a measurement.
        contact_force_change: Predicted change of the force between the bones of the joint [N], motion and
            muscle forces held; in the brace's frame, on the distal bone.
        contact_moment_change: The same of the moment about the joint's centre [N*m].
        passive_levels: Passive frontal stiffnesses for which the prediction was repeated [N*m/deg].
        passive_sensitivity: Largest predicted change of each angle for each of them [rad].
        reaction_upper: Force of the brace's support at the upper loop per frame [N].
        reaction_lower: The same at the lower loop [N].
        volume_fraction: Mean volume fraction [-].
        volume_fraction_uniform: That of the uniform design [-].
    """

    seed: int
    iterations: int
    solver: str
    shapes: int
    parameters: Float[Array, "*layer"]
    d_triangle: Float[Array, " triangle"]
    d_vertex: Float[Array, " cut_vertex"]
    width_triangle: Float[Array, " triangle"]
    width_vertex: Float[Array, " cut_vertex"]
    youngs_modulus: Float[Array, " triangle"]
    volume_fraction_triangle: Float[Array, " triangle"]
    firm_triangle: Float[Array, " triangle"]
    firm_vertex: Float[Array, " vertex"]
    rim: Bool[Array, " triangle"]
    energy_density: Float[Array, " triangle"]
    pulls: Float[Array, "loss triangle"]
    history: Float[Array, "iteration term"]
    trace: Float[Array, "iteration column"]
    film: UInt8[Array, "snapshot cut_vertex"]
    film_iterations: Int[Array, " snapshot"]
    losses_initial: Float[Array, " loss"]
    losses_final: Float[Array, " loss"]
    stiffness: Float[Array, "3"]
    stiffness_uniform: Float[Array, "3"]
    stiffness_flexions: Float[Array, " posture"]
    stiffness_posed: Float[Array, "posture 3"]
    stiffness_posed_uniform: Float[Array, "posture 3"]
    stiffness_by_energy: float
    moment_flexions: Float[Array, " flexion"]
    moment_held: Float[Array, "2 flexion"]
    moment_free: Float[Array, "2 flexion"]
    coupling: str
    angle_changes: Float[Array, "coupling frame 3"]
    contact_force_change: Float[Array, "coupling frame 3"]
    contact_moment_change: Float[Array, "coupling frame 3"]
    passive_levels: Float[Array, " level"]
    passive_sensitivity: Float[Array, "level coupling 3"]
    reaction_upper: Float[Array, "frame 3"]
    reaction_lower: Float[Array, "frame 3"]
    volume_fraction: float
    volume_fraction_uniform: float

    @property
    def angle_change(self) -> Float[Array, "frame 3"]:
        """Predicted change of the joint's three angles per frame by the design's own coupling [rad]."""
        return self.angle_changes[COUPLINGS.index(self.coupling)]

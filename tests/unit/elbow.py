"""A round tube with a right-angled bend, whose inner side is as hollow as one wants it."""

from __future__ import annotations

import numpy as np

from hilbrace.domain.deformation import deformation_gradients
from hilbrace.domain.domain import Domain
from hilbrace.domain.flatten import periodic_lscm, quasi_conformal
from hilbrace.domain.limb import Surface
from hilbrace.domain.seam import cut_along

TUBE_MM = 30.0


def elbow_domain(hollow_mm: float, around: int = 40, leg_mm: float = 40.0, step_mm: float = 5.0) -> Domain:
    """Two legs and a quarter turn between them; the skin's inner side bends with radius ``hollow_mm``."""
    bend = hollow_mm + TUBE_MM
    arc = np.linspace(0.0, np.pi / 2, max(4, round(np.pi / 2 * bend / step_mm)) + 1)
    legs = round(leg_mm / step_mm)
    centre, turn = [], []
    for k in range(legs):
        centre.append((bend, -leg_mm + k * step_mm))
        turn.append(0.0)
    for a in arc:
        centre.append((bend * np.cos(a), bend * np.sin(a)))
        turn.append(a)
    for k in range(1, legs + 1):
        centre.append((-k * step_mm, bend))
        turn.append(np.pi / 2)
    angle = 2 * np.pi * np.arange(around) / around
    rows = [
        np.stack(
            [
                x + TUBE_MM * np.cos(angle) * np.cos(a),
                y + TUBE_MM * np.cos(angle) * np.sin(a),
                -TUBE_MM * np.sin(angle),
            ],
            axis=1,
        )
        for (x, y), a in zip(centre, turn, strict=True)
    ]
    count = len(rows)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(count - 1), np.arange(around), indexing="ij"))
    a, b = i * around + j, i * around + (j + 1) % around
    c, d = a + around, b + around
    surface = Surface(np.concatenate(rows), np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)]))
    cut = cut_along(surface, np.arange(count) * around)
    flat = periodic_lscm(surface.vertices, cut)
    posed = surface.vertices[None]
    return Domain(
        joint="ankle_l",
        vertices=surface.vertices,
        triangles=surface.triangles,
        upper_loop=(count - 1) * around + np.arange(around),
        lower_loop=np.arange(around),
        cut_triangles=cut.triangles,
        weld=cut.weld,
        uv=flat.uv,
        seam_pairs=cut.pairs,
        flatten="periodic",
        period_u=flat.period_u,
        time=np.zeros(1),
        posed=posed,
        deformation=deformation_gradients(surface.vertices, posed, surface.triangles),
        quasi_conformal=quasi_conformal(surface.vertices[cut.weld], flat.uv, cut.triangles),
    )

"""The knee-like sleeve opened for its flat maps, with a window at the kneecap where one is asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hilbrace.domain.distortion import MapDistortion, map_distortion
from hilbrace.domain.domain import Domain
from hilbrace.domain.flatten import Method, flatten
from hilbrace.domain.seam import Cut
from tests.unit.sleeve import sleeve_domain


def opened_sleeve(window_mm: float = 0.0, around: int = 60, along: int = 33) -> Domain:
    """The sleeve, without the triangles nearer than this to the middle of its front."""
    domain = sleeve_domain(around, along)
    centre = domain.vertices[domain.triangles].mean(axis=1)
    front = domain.vertices[around // 2 * (along + 1) + along // 2]
    kept = np.linalg.norm(centre - front, axis=1) > window_mm
    used, cut_triangles = np.unique(domain.cut_triangles[kept], return_inverse=True)
    vertices, weld = np.unique(domain.weld[used], return_inverse=True)
    place = np.full(len(domain.vertices), -1)
    place[vertices] = np.arange(len(vertices))
    cut_place = np.full(len(domain.weld), -1)
    cut_place[used] = np.arange(len(used))
    return replace(
        domain,
        vertices=domain.vertices[vertices],
        triangles=place[domain.triangles[kept]],
        upper_loop=place[domain.upper_loop],
        lower_loop=place[domain.lower_loop],
        cut_triangles=cut_triangles.reshape(-1, 3),
        weld=weld,
        uv=domain.uv[used],
        seam_pairs=cut_place[domain.seam_pairs],
        posed=domain.posed[:, vertices],
        deformation=domain.deformation[:, kept],
        quasi_conformal=domain.quasi_conformal[kept],
    )


def flattened(domain: Domain, method: Method) -> tuple[Domain, MapDistortion]:
    """The sleeve with another flat map, and that map's figures."""
    half = len(domain.upper_loop) // 2
    front = [int(np.argmax(domain.weld == loop[half])) for loop in (domain.lower_loop, domain.upper_loop)]
    cut = Cut(domain.cut_triangles, domain.weld, domain.seam_pairs)
    flat = flatten(domain.vertices, cut, (front[0], front[1]), method)
    remade = replace(domain, uv=flat.uv, period_u=flat.period_u, flatten=method)
    return remade, map_distortion(remade)

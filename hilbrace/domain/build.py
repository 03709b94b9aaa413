"""The domain stage: skin and motion in, flat and moving sleeve out."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.body.body import Body
from hilbrace.config import DomainSettings
from hilbrace.domain.deformation import check_deformation, deformation_gradients
from hilbrace.domain.domain import Domain
from hilbrace.domain.flatten import quasi_conformal
from hilbrace.domain.frames import frames_of, pose_in_distal
from hilbrace.domain.rest import rest_domain

Array = np.ndarray


def build_domain(body: Body, loads: JointLoads, settings: DomainSettings) -> Domain:
    """Cut, mesh, open, flatten and move the design domain.

    Args:
        body: The subject's body in the neutral pose.
        loads: Coordinates and forces per frame.
        settings: Where the brace sits and how it is meshed.

    Raises:
        GeometryError: The region is no sleeve, cannot be meshed or flattened, or its skin collapses.
        ConfigError: The recording lacks the braced joint.
    """
    rest = rest_domain(body, settings)
    frames = frames_of(loads, rest.joint, settings.frames_per_second)
    vertices, triangles = rest.surface.vertices, rest.surface.triangles
    posed = pose_in_distal(rest.worn, rest.joint, body, loads.coordinate_names, loads.coordinates[frames])
    deformation = deformation_gradients(vertices, posed, triangles)
    check_deformation(deformation, loads.time[frames])
    opened = vertices[rest.cut.weld]
    return Domain(
        joint=rest.joint,
        vertices=vertices,
        triangles=triangles,
        upper_loop=rest.loops.upper,
        lower_loop=rest.loops.lower,
        cut_triangles=rest.cut.triangles,
        weld=rest.cut.weld,
        uv=rest.flat.uv,
        seam_pairs=rest.cut.pairs,
        flatten=settings.flatten,
        period_u=rest.flat.period_u,
        time=loads.time[frames],
        posed=posed,
        deformation=deformation,
        quasi_conformal=quasi_conformal(opened, rest.flat.uv, rest.cut.triangles),
        windows=_numbered(rest.loops.windows),
        rims=_rims(settings, len(rest.loops.windows)),
    )


def _numbered(windows: tuple[Int[Array, " _corner"], ...]) -> Int[Array, "corner 2"]:
    """Edges of windows as rows of (number of the window, vertex)."""
    rows = [np.stack([np.full(len(loop), k), loop], axis=1) for k, loop in enumerate(windows)]
    return np.concatenate([np.zeros((0, 2), np.int64), *rows])


def _rims(settings: DomainSettings, windows: int) -> Float[Array, " loop"]:
    """Widths of the bands at the upper edge, the lower edge and the windows [mm], NaN where not given."""
    wanted = [settings.upper_rim_mm, settings.lower_rim_mm, *[settings.window_rim_mm] * windows]
    return np.array([np.nan if width is None else width for width in wanted])

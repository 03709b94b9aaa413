"""How true a flat map is: its angles, areas and seam, and what to do where it leaves its limits.

The pattern is drawn in the flat map. Where the map enlarges the skin the cells come out smaller on the limb,
and where it changes angles they are sheared; neither shows in the map itself.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.domain.deformation import local_edges
from hilbrace.domain.domain import Domain
from hilbrace.domain.flatten import map_gradients, quasi_conformal

Array = np.ndarray

AREA_LIMITS = (0.5, 2.0)
"""Area ratios between which a conformal map's cells count as alike [-]."""
ANGLE_LIMIT = 1.10
"""Mean ratio of the singular values above which a map shears its cells visibly [-]."""
CLOSED = 1e-9
"""Largest gap at which a periodic seam counts as closed [uv units]."""


@dataclass(frozen=True)
class MapDistortion:
    """Figures of a flat map.

    Attributes:
        flipped_triangles: Triangles that the map turns over.
        quasi_conformal_mean: Ratio of the map's singular values, mean over the triangles [-]; 1 is conformal.
        quasi_conformal_p99: Its 99th percentile [-].
        quasi_conformal_max: Its largest value [-].
        map_area_ratio_min: Least area in the map over area on the skin, where the whole map has 1 [-].
        map_area_ratio_max: The largest [-].
        seam_gap: Largest distance of a seam pair from one period apart [uv units]; NaN for a free seam.
    """

    flipped_triangles: int
    quasi_conformal_mean: float
    quasi_conformal_p99: float
    quasi_conformal_max: float
    map_area_ratio_min: float
    map_area_ratio_max: float
    seam_gap: float

    def figures(self) -> dict[str, float | int | None]:
        """The figures by name, rounded, ``None`` for what the map does not have."""
        values = asdict(self)
        gap = values.pop("seam_gap")
        rounded = {k: v if isinstance(v, int) else round(v, 4) for k, v in values.items()}
        return rounded | {"seam_gap": None if np.isnan(gap) else gap}


def map_distortion(domain: Domain) -> MapDistortion:
    """Figures of a domain's flat map."""
    surface, flat = domain.vertices[domain.weld], domain.uv
    gradient = map_gradients(surface, flat, domain.cut_triangles)
    ratio = quasi_conformal(surface, flat, domain.cut_triangles)
    area = area_ratio(domain)
    gap = np.nan
    if domain.period_u:
        jump = flat[domain.seam_pairs[:, 1]] - flat[domain.seam_pairs[:, 0]] - [domain.period_u, 0.0]
        gap = float(np.linalg.norm(jump, axis=1).max())
    return MapDistortion(
        flipped_triangles=int((np.linalg.det(gradient) <= 0.0).sum()),
        quasi_conformal_mean=float(ratio.mean()),
        quasi_conformal_p99=float(np.percentile(ratio, 99)),
        quasi_conformal_max=float(ratio.max()),
        map_area_ratio_min=float(area.min()),
        map_area_ratio_max=float(area.max()),
        seam_gap=gap,
    )


def area_ratio(domain: Domain) -> Float[Array, " triangle"]:
    """Area in the map over area on the skin per triangle, relative to that of the whole map [-].

    Cells are ``1 / sqrt(ratio)`` times as long on the limb as those of mean size.
    """
    surface = domain.vertices[domain.weld]
    on_skin = np.linalg.det(local_edges(surface, domain.cut_triangles))
    in_map = on_skin * np.linalg.det(map_gradients(surface, domain.uv, domain.cut_triangles))
    return in_map / on_skin * (on_skin.sum() / in_map.sum())


def advice(found: MapDistortion, method: str) -> tuple[str, ...]:
    """What to change where a map leaves its limits, in whole sentences; nothing if it keeps them.

    Args:
        found: Figures of the map.
        method: How it was made, ``domain.flatten``.
    """
    said = []
    low, high = found.map_area_ratio_min, found.map_area_ratio_max
    if found.flipped_triangles:
        said.append(
            f"the flat map turns {found.flipped_triangles} triangles over: take another domain.flatten,"
            " a shorter region or more triangles"
        )
    elif low < AREA_LIMITS[0] or high > AREA_LIMITS[1]:
        said.append(_about_areas(low, high, method))
    if found.quasi_conformal_mean > ANGLE_LIMIT:
        other = "domain.flatten = 'lscm' or 'periodic' keeps" if method == "slim" else "more triangles keep"
        said.append(
            f"the {method} map stretches cells {found.quasi_conformal_mean:.2f} times as much one way as the"
            f" other on average: {other} their angles"
        )
    if found.seam_gap > CLOSED:
        said.append(f"the periodic map misses its seam by {found.seam_gap:.1g} of the map: flatten anew")
    return tuple(said)


def _about_areas(low: float, high: float, method: str) -> str:
    sizes = f"from {1.0 / np.sqrt(high):.2f} to {1.0 / np.sqrt(low):.2f} times their mean length"
    mend = {
        "lscm": "domain.flatten = 'slim' keeps their size, at the price of their angles",
        "periodic": "domain.flatten = 'slim' keeps their size but does not close at the seam; 'lscm' may do,"
        " and so may a shorter region (domain.above, domain.below)",
        "slim": "a shorter region or a window keeps them alike; no flat map of this one does",
    }
    return (
        f"the area ratio of the {method} map runs from {low:.2f} to {high:.2f}, outside [{AREA_LIMITS[0]:g},"
        f" {AREA_LIMITS[1]:g}], so that cells on the limb are {sizes}: {mend[method]}"
    )

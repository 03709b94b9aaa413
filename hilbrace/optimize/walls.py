"""The wall of a design as what it is: two orthotropic microstructures laid along the flat map.

The optimizer knows one modulus per triangle, as the paper does. The section made here goes into
`hilbrace.shell.build_shell` in the place of Poisson's ratio, with the rubber's own modulus for all triangles:
the stiffness that the struts leave, in their own directions, is in the section.

It is a check on finished designs and no part of the loop, whose gradient it would not follow. With it, the
cells' larger bending stiffness included, the frontal over sagittal stiffness against the uniform brace's is
6.6 instead of 8.1 with the joint straight and 4.1 instead of 4.6 at 59 deg (left knee of the built-in serve),
and 7.5 instead of 7.9 and 5.1 instead of 5.6 in the recorded drop jump; the frontal stiffness is not below
the uniform brace's in either.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.config import MaterialSettings, PatternSettings
from hilbrace.domain.domain import Domain
from hilbrace.material.strut_width import cell_scale, map_length
from hilbrace.material.walls import blended_walls
from hilbrace.optimize.design import Design
from hilbrace.shell import Section, map_directions

Array = np.ndarray


def orthotropic_section(
    domain: Domain, design: Design, material: MaterialSettings, pattern: PatternSettings
) -> Section:
    """Section of every triangle of a design, relative to the solid rubber.

    Axis 1 runs along u of the flat map. Rims are solid and isotropic. Where the map shrinks or stretches, the
    cells do, and the wall is thicker or thinner in cell sides.

    Args:
        domain: The brace's surface and its flat map.
        design: The optimized design: its field, segmentation and rims.
        material: The rubber, its thickness and the two cells.
        pattern: Scale of the cells.

    Raises:
        GeometryError: A triangle has no area in the map, or the design a value out of its range.
        InputError: A cell of the user's own has no table.
    """
    walls = blended_walls(
        soft=material.soft,
        firm=material.firm,
        d=design.d_triangle,
        firm_fraction=design.firm_triangle,
        thickness=material.thickness_mm / cell_side_mm(domain, pattern),
        poisson=material.poisson,
        solid=design.rim,
    )
    corners = domain.vertices[domain.triangles]
    directions = map_directions(corners, domain.uv[domain.cut_triangles])
    return Section(walls.membrane, walls.bending, walls.shear, directions)


def cell_side_mm(domain: Domain, pattern: PatternSettings) -> Float[Array, " triangle"]:
    """Side of a unit cell on the limb, in each triangle [mm].

    Args:
        domain: The brace's surface and its flat map.
        pattern: Scale of the cells.
    """
    scale = cell_scale(pattern, domain)
    return scale / 2 * map_length(domain.vertices, domain.triangles, domain.uv, domain.cut_triangles)

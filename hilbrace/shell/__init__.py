"""Shell finite elements of the brace: modulus per triangle in, compliance, reactions and stiffness out."""

from hilbrace.shell.boundary import boundary_loops, end_loops
from hilbrace.shell.brace_stiffness import BraceStiffness, brace_stiffness
from hilbrace.shell.foundation import Foundation, skin
from hilbrace.shell.geometry import GeometryMode, ShellFamily, cluster_frames, geometry_mode, shell_family
from hilbrace.shell.joint_stiffness import family_wrenches_at, joint_stiffness, wrenches_at
from hilbrace.shell.loads import LoadPattern, NodalLoads, joint_line_shares
from hilbrace.shell.model import ShellModel, build_shell, lay_on_skin, pose_shell, thicken_shell
from hilbrace.shell.pool import SolverPool, open_pool
from hilbrace.shell.response import (
    FamilyResponse,
    ShellResponse,
    SkinReaction,
    displacements,
    element_energies,
    family_compliance,
    family_response,
    family_stiffness,
    loop_stiffness,
    shell_response,
    skin_reaction,
    static_modes,
)
from hilbrace.shell.section import Section, isotropic, map_directions, map_rotations, orthotropic
from hilbrace.shell.solver import available_backends, open_solver

__all__ = [
    "BraceStiffness",
    "FamilyResponse",
    "Foundation",
    "GeometryMode",
    "LoadPattern",
    "NodalLoads",
    "Section",
    "ShellFamily",
    "ShellModel",
    "ShellResponse",
    "SkinReaction",
    "SolverPool",
    "available_backends",
    "boundary_loops",
    "brace_stiffness",
    "build_shell",
    "cluster_frames",
    "displacements",
    "element_energies",
    "end_loops",
    "family_compliance",
    "family_response",
    "family_stiffness",
    "family_wrenches_at",
    "geometry_mode",
    "isotropic",
    "joint_line_shares",
    "joint_stiffness",
    "lay_on_skin",
    "loop_stiffness",
    "map_directions",
    "map_rotations",
    "open_pool",
    "open_solver",
    "orthotropic",
    "pose_shell",
    "shell_family",
    "shell_response",
    "skin",
    "skin_reaction",
    "static_modes",
    "thicken_shell",
    "wrenches_at",
]

"""Shell finite elements of the brace: modulus per triangle in, compliance, reactions and stiffness out."""

from hilbrace.shell.autograd import ShellResponse, displacements, loop_stiffness, shell_response, static_modes
from hilbrace.shell.loads import LoadPattern, joint_line_shares
from hilbrace.shell.model import ShellModel, build_shell, pose_shell
from hilbrace.shell.stiffness import joint_stiffness, wrenches_at

__all__ = [
    "LoadPattern",
    "ShellModel",
    "ShellResponse",
    "build_shell",
    "displacements",
    "joint_line_shares",
    "joint_stiffness",
    "loop_stiffness",
    "pose_shell",
    "shell_response",
    "static_modes",
    "wrenches_at",
]

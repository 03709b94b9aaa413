"""The neural field d(u, v): its kinds behind one protocol, and the projection into the design's range."""

from hilbrace.field.build import build_field
from hilbrace.field.gaussian import GaussianField, hyperplane_weights, initial_parameters
from hilbrace.field.network import NetworkField
from hilbrace.field.projection import project, project_to_volume
from hilbrace.field.protocol import Field

__all__ = [
    "Field",
    "GaussianField",
    "NetworkField",
    "build_field",
    "hyperplane_weights",
    "initial_parameters",
    "project",
    "project_to_volume",
]

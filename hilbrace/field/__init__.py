"""The neural field d(u, v): Gaussian neurons and the projection into the range of the design variable."""

from hilbrace.field.gaussian import GaussianField, hyperplane_weights, initial_parameters
from hilbrace.field.projection import project, project_to_volume

__all__ = ["GaussianField", "hyperplane_weights", "initial_parameters", "project", "project_to_volume"]

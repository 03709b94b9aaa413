"""The configuration: one file per section, and ``run_file`` that reads them from a ``run.toml``."""

from hilbrace.config.biomech import BiomechSettings
from hilbrace.config.body import BodySettings
from hilbrace.config.domain import DomainSettings
from hilbrace.config.material import MaterialSettings
from hilbrace.config.mold import MoldSettings
from hilbrace.config.motion import MotionSettings
from hilbrace.config.optimize import (
    ANGLES,
    ASSUMED_PASSIVE,
    LossWeights,
    OptimizeSettings,
    controlled_angles,
    passive_stiffness,
)
from hilbrace.config.pattern import PatternSettings, SolidSettings
from hilbrace.config.presets import OPEN, PRESETS, PresetName, departures, preset_overrides
from hilbrace.config.run_file import Config, apply_overrides, known_keys, parse_config, read_config
from hilbrace.config.section import Section
from hilbrace.config.subject import SubjectSettings

__all__ = [
    "ANGLES",
    "ASSUMED_PASSIVE",
    "OPEN",
    "PRESETS",
    "BiomechSettings",
    "BodySettings",
    "Config",
    "DomainSettings",
    "LossWeights",
    "MaterialSettings",
    "MoldSettings",
    "MotionSettings",
    "OptimizeSettings",
    "PatternSettings",
    "PresetName",
    "Section",
    "SolidSettings",
    "SubjectSettings",
    "apply_overrides",
    "controlled_angles",
    "departures",
    "known_keys",
    "parse_config",
    "passive_stiffness",
    "preset_overrides",
    "read_config",
]

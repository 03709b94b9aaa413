"""The ``scan`` body: what ``hilbrace scan fit`` made of a person's scan, hung on the skeleton."""

from __future__ import annotations

from hilbrace.body.body import LooseSkin, ScannedBody
from hilbrace.config import BodySettings
from hilbrace.errors import ConfigError
from hilbrace.run.records import load


def scanned_skin(settings: BodySettings) -> LooseSkin:
    """The skin of a fitted scan, with its joints and weights.

    Raises:
        ConfigError: No file is named.
        InputError: The file is none of a fitted scan.
    """
    if settings.model_file is None:
        raise ConfigError(
            "no fitted scan is named",
            where="body.model_file",
            hint="name the body.npz of `hilbrace scan fit` for body.model = 'scan'",
        )
    fitted = load(ScannedBody, settings.model_file)
    return LooseSkin(
        model="scan",
        shape=fitted.shape,
        vertices=fitted.vertices,
        triangles=fitted.triangles,
        raw_weights=fitted.raw_weights,
        smoothed_on=fitted.smoothed_on,
        joints=dict(zip(fitted.joint_names, fitted.joint_centres, strict=True)),
        whole=False,
    )

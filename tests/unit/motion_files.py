"""A small laboratory for tests: one person, two force plates, and files as real ones come."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hilbrace.config import MotionSettings, SubjectSettings
from hilbrace.motion.opensim_files import write_storage, write_trc
from hilbrace.units import GRAVITY

MASS_KG = 70.0
RATE_HZ = 100.0
FRAMES = 120

PLACES = {
    "C7": (-0.08, 1.48, 0.0),
    "LASI": (0.10, 1.00, -0.12),
    "LPSI": (-0.10, 1.02, -0.05),
    "LACR": (0.00, 1.42, -0.18),
    "LLFC": (0.00, 0.52, -0.17),
    "LLMAL": (0.00, 0.09, -0.16),
    "LCAL": (-0.06, 0.04, -0.10),
    "LTOE": (0.14, 0.04, -0.10),
    "LMT5": (0.10, 0.03, -0.16),
    "LTH1": (0.05, 0.80, -0.15),
    "LLEL": (0.00, 1.10, -0.30),
}
CENTRES = {"right": (0.03, 0.0, 0.12), "left": (0.05, 0.0, -0.11)}
MAP = """
ignored = ["*_virtual"]
optional = ["LLEL", "RLEL"]
[landmarks]
""" + "\n".join(
    f'{side}{name[1:]} = "{side}{name[1:]}"'
    for name in PLACES
    for side in ("L", "R")
    if name.startswith("L") and name != "LTH1"
)
MAP += '\nC7 = "C7"\n[clusters]\nLTH1 = "femur_l"\nRTH1 = "femur_r"\n'


def marker_names() -> tuple[str, ...]:
    """Names of all markers, right and left."""
    return tuple(PLACES) + tuple("R" + name[1:] for name in PLACES if name.startswith("L"))


def time() -> np.ndarray:
    """The markers' instants [s]."""
    return np.arange(FRAMES) / RATE_HZ


def bend(instants: np.ndarray) -> np.ndarray:
    """How far the person goes down [m]: still for 0.4 s, then a small squat."""
    return 0.1 * np.sin(np.pi * np.clip((instants - 0.4) / 0.7, 0, 1)) ** 2


def markers(names: tuple[str, ...] | None = None) -> np.ndarray:
    """Positions of all markers [m], y up."""
    paths = []
    for name in names or marker_names():
        x, y, z = PLACES.get(name) or PLACES["L" + name[1:]]
        sign = 1.0 if name in PLACES else -1.0
        down = bend(time()) * min(1.0, max(0.0, (y - 0.15) / 0.6))
        paths.append(np.column_stack([x + 0 * down, y - down, sign * z + 0 * down]))
    return np.stack(paths, axis=1)


def vertical(instants: np.ndarray) -> np.ndarray:
    """Vertical force on each foot [N]."""
    return MASS_KG * GRAVITY / 2 * (1 + 0.3 * np.sin(4 * np.pi * np.clip(instants - 0.4, 0, 0.5)))


def force_columns(instants: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of a MOT file: plate 1 under the right foot, plate 2 under the left one, plate 3 empty."""
    columns = {}
    for plate, foot in (("1", "right"), ("2", "left"), ("3", None)):
        load = vertical(instants) if foot else 0 * instants
        centre = CENTRES[foot] if foot else (0.0, 0.0, 0.0)
        for axis, share in zip("xyz", (0.05, 1.0, -0.1), strict=True):
            columns[f"ground_force_{plate}_v{axis}"] = share * load
        for axis, value in zip("xyz", centre, strict=True):
            columns[f"ground_force_{plate}_p{axis}"] = value + 0 * instants
        for axis, value in zip("xyz", (0.0, 0.01, 0.0), strict=True):
            columns[f"ground_force_{plate}_m{axis}"] = value * load
    return columns


@dataclass(frozen=True)
class Files:
    """Paths of one recording, and the settings that read it."""

    folder: Path

    def settings(self, **changes: Any) -> MotionSettings:
        """Settings of the TRC and MOT files."""
        values = {
            "markers": self.folder / "move.trc",
            "forces": self.folder / "move.mot",
            "marker_map": str(self.folder / "map.toml"),
        }
        return MotionSettings(**(values | changes))

    def edit(self, name: str, old: str, new: str, count: int = 1) -> None:
        """Replace text in a file; the text must be there."""
        path = self.folder / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, count))


SUBJECT = SubjectSettings()


def write_files(folder: Path, force_rate_hz: float = 500.0) -> Files:
    """Write TRC, MOT and the marker map."""
    (folder / "map.toml").write_text(MAP)
    write_trc(folder / "move.trc", time(), RATE_HZ, marker_names(), markers())
    instants = np.arange(int(FRAMES * force_rate_hz / RATE_HZ)) / force_rate_hz
    write_storage(folder / "move.mot", instants, force_columns(instants), degrees=False, name="forces")
    return Files(folder)


def to_lab(vectors: np.ndarray) -> np.ndarray:
    """From y up to a laboratory's z up."""
    return np.stack([vectors[..., 0], -vectors[..., 2], vectors[..., 1]], axis=-1)


def write_c3d(
    path: Path,
    names: tuple[str, ...] | None = None,
    positions: np.ndarray | None = None,
    per_frame: int = 4,
    sign: float = -1.0,
) -> Path:
    """Write a C3D file with two plates of type 2 (plate frame: x as the laboratory, y against it, z down)."""
    import ezc3d

    names = names or marker_names()
    positions = markers() if positions is None else positions
    content = ezc3d.c3d()
    points = np.ones((4, len(names), len(positions)))
    points[:3] = 1000 * to_lab(positions).transpose(2, 1, 0)
    group = content["parameters"]["POINT"]
    group["RATE"]["value"], group["LABELS"]["value"], group["UNITS"]["value"] = [RATE_HZ], list(names), ["mm"]
    content["data"]["points"] = points
    instants = np.arange(len(positions) * per_frame) / (RATE_HZ * per_frame)
    channels, corners = [], []
    for foot in ("right", "left"):
        load = vertical(instants)
        force = to_lab(load[:, None] * np.array([0.05, 1.0, -0.1]))
        middle = to_lab(np.array([0.0, 0.0, 0.15 if foot == "right" else -0.15]))
        arm = to_lab(np.array(CENTRES[foot])) - middle
        moment = np.cross(arm, force)
        moment[:, 2] += 0.01 * load
        to_plate = np.array([1.0, -1.0, -1.0]) * -sign
        channels += [*(force * to_plate).T, *(1000 * moment * to_plate).T]
        around = ((1, -1), (-1, -1), (-1, 1), (1, 1))
        corners.append(1000 * np.array([[0.3 * a, middle[1] + 0.15 * b, 0.0] for a, b in around]).T)
    analog = content["parameters"]["ANALOG"]
    analog["RATE"]["value"] = [RATE_HZ * per_frame]
    analog["LABELS"]["value"] = [f"c{k}" for k in range(12)]
    analog["UNITS"]["value"] = ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * 2
    analog["SCALE"]["value"], analog["OFFSET"]["value"] = [1.0] * 12, [0] * 12
    analog["GEN_SCALE"]["value"] = [1.0]
    content["data"]["analogs"] = np.array(channels)[None]
    plates = content["parameters"]["FORCE_PLATFORM"]
    for key, value in {
        "USED": [2],
        "TYPE": [2, 2],
        "ZERO": [1, 0],
        "CORNERS": np.stack(corners, -1),
        "ORIGIN": np.zeros((3, 2)),
        "CHANNEL": np.arange(1, 13).reshape(2, 6).T,
    }.items():
        plates[key]["value"] = value
    content.write(str(path))
    return path

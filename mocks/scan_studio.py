"""A projector, a camera, and a leg or a calibration board: pictures as a laboratory's camera writes them.

Surfaces are triangles; every pixel's ray is cut with the plane of the triangle that it sees, so that the true
surface is known exactly. Light falls off with distance and slope, the projector is not linear, out of focus
and casts shadows, the camera blurs, adds noise and clips. Nothing here comes from the decoder under test.

Run as a process of its own it reads a folder of patterns and writes one picture of each:
``python -m mocks.scan_studio --patterns DIR --out DIR --scene leg --turn 20``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from hilbrace.body.anny_lite import load_anny_lite

LOOK_AT = 620.0
"""Distance from the camera at which both look [mm]."""
BASE = 160.0
"""Distance of the projector from the camera, to its left [mm]."""


@dataclass(frozen=True)
class Lens:
    """A pinhole with OpenCV's distortion."""

    size: tuple[int, int]
    matrix: np.ndarray
    distortion: np.ndarray

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels of points in the lens' frame."""
        flat = points.reshape(-1, 1, 3).astype(float)
        pixels = cv2.projectPoints(flat, np.zeros(3), np.zeros(3), self.matrix, self.distortion)[0]
        return pixels.reshape(*points.shape[:-1], 2)

    def rays(self) -> np.ndarray:
        """Direction of every pixel's ray, z = 1."""
        width, height = self.size
        y, x = np.mgrid[:height, :width].astype(float)
        pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
        flat = cv2.undistortPoints(pixels, self.matrix, self.distortion, criteria=criteria)
        return np.concatenate([flat.reshape(height, width, 2), np.ones((height, width, 1))], axis=-1)


@dataclass(frozen=True)
class Rig:
    """Camera and projector; a point x of the camera's frame is R x + t in the projector's [mm]."""

    camera: Lens
    projector: Lens
    rotation: np.ndarray
    translation: np.ndarray


@dataclass(frozen=True)
class Light:
    """What spoils the pictures: grey levels of 255, pixels."""

    noise: float = 2.0
    camera_blur: float = 0.7
    projector_blur: float = 0.6
    gamma: float = 1.8
    ambient: float = 18.0
    gain: float = 190.0
    offset: float = 4.0


@dataclass(frozen=True)
class Scene:
    """Triangles in the camera's frame [mm] with their reflectance, a function of point and triangle."""

    vertices: np.ndarray
    triangles: np.ndarray
    albedo: Callable[[np.ndarray, np.ndarray], np.ndarray]
    solid: trimesh.Trimesh = field(repr=False)


def make_rig(camera: tuple[int, int] = (960, 720), projector: tuple[int, int] = (1280, 720)) -> Rig:
    """An ordinary pair: 50 degrees across, some distortion, base 160 mm."""
    (w, h), (pw, ph) = camera, projector
    lens = Lens(
        camera,
        np.array([[1.2 * w, 0, 0.5 * w + 3.4], [0, 1.2 * w, 0.5 * h - 2.7], [0, 0, 1.0]]),
        np.array([-0.11, 0.06, 4e-4, -3e-4, 0.0]),
    )
    beamer = Lens(
        projector,
        np.array([[1.15 * pw, 0, 0.5 * pw - 5.0], [0, 1.15 * pw, 0.56 * ph], [0, 0, 1.0]]),
        np.array([-0.04, 0.02, -2e-4, 3e-4, 0.0]),
    )
    centre = np.array([-BASE, -12.0, 5.0])
    rotation = Rotation.from_euler("yx", [-np.degrees(np.arctan(BASE / LOOK_AT)), 3.5], degrees=True)
    matrix = rotation.as_matrix()
    return Rig(lens, beamer, matrix, -matrix @ centre)


def leg_scene(turn: float = 0.0, shape: Sequence[float] = (), wall: bool = False) -> Scene:
    """The left leg of the built-in body from mid-thigh to mid-shank, turned about its axis [deg]."""
    model = load_anny_lite()
    skin = trimesh.Trimesh(model.vertices(np.array(shape)) * 1000.0, model.triangles, process=False)
    joints = {name: place * 1000.0 for name, place in model.joints(np.array(shape)).items()}
    knee, ankle = joints["knee_l"], joints["ankle_l"]
    middle = skin.triangles_center
    near = (middle[:, 2] < 0.0) & (np.abs(middle[:, 1] - knee[1]) < 260.0)
    near &= np.linalg.norm((middle - knee)[:, [0, 2]], axis=1) < 180.0
    leg = skin.submesh([np.flatnonzero(near)], append=True)
    leg = max(leg.split(only_watertight=False), key=lambda part: len(part.faces)).subdivide_loop(1)
    down = (ankle - knee) / np.linalg.norm(ankle - knee)
    own = (leg.vertices - knee) @ Rotation.align_vectors([[0, -1, 0]], [down])[0].as_matrix().T
    own = own @ Rotation.from_euler("y", turn, degrees=True).as_matrix().T
    # The front of the leg (+x) faces the camera (-z), up (+y) is up in the picture (-y), its right is left.
    seen = np.stack([-own[:, 2], -own[:, 1], LOOK_AT - own[:, 0]], axis=1)
    mesh = trimesh.Trimesh(seen, leg.faces, process=False)

    def skin_tone(points: np.ndarray, triangle: np.ndarray) -> np.ndarray:
        back = np.stack([LOOK_AT - points[..., 2], -points[..., 1], -points[..., 0]], axis=-1)
        at_rest = back @ Rotation.from_euler("y", turn, degrees=True).as_matrix()
        freckles = np.sin(at_rest / 7.0).prod(axis=-1) * 0.06 + np.sin(at_rest @ [0.11, 0.07, 0.05]) * 0.05
        return np.where(triangle < len(leg.faces), 0.62 + freckles, 0.4)

    if not wall:
        return Scene(mesh.vertices, mesh.faces, skin_tone, mesh)
    corners = np.array([[-900, -700, 1250], [900, -700, 1250], [900, 700, 1250], [-900, 700, 1250.0]])
    points = np.concatenate([mesh.vertices, corners])
    count = len(own)
    walls = np.array([[count, count + 1, count + 2], [count, count + 2, count + 3]])
    return Scene(points, np.concatenate([mesh.faces, walls]), skin_tone, mesh)


def board_scene(
    texture: np.ndarray, size_mm: tuple[float, float], tilt: Sequence[float], place: Sequence[float]
) -> Scene:
    """A flat board with a printed picture, tilted (degrees about x, y, z), its middle at a place [mm]."""
    width, height = size_mm
    grid = [np.linspace(0, side, 13) for side in (width, height)]
    x, y = (axis.ravel() for axis in np.meshgrid(*grid))
    flat = np.stack([x, y, np.zeros_like(x)], axis=1)
    k = np.arange(12 * 13).reshape(12, 13)[:, :12].ravel()
    triangles = np.concatenate([np.stack([k, k + 1, k + 14], 1), np.stack([k, k + 14, k + 13], 1)])
    rotation = Rotation.from_euler("xyz", tilt, degrees=True).as_matrix()
    middle = np.array([width / 2, height / 2, 0.0])
    vertices = (flat - middle) @ rotation.T + place
    paint = texture.astype(np.float32) / 255.0

    def printed(points: np.ndarray, triangle: np.ndarray) -> np.ndarray:
        on = ((points - place) @ rotation + middle)[..., :2] / [width, height]
        pixel = (on * [paint.shape[1], paint.shape[0]] - 0.5).astype(np.float32)
        shade = cv2.remap(
            paint, pixel[..., 0], pixel[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return 0.09 + 0.66 * shade

    return Scene(vertices, triangles, printed, trimesh.Trimesh(vertices, triangles, process=False))


BOARD_POSES = (
    ((0, 0, 0), (0, 0, 600)), ((24, 0, 4), (-85, 40, 640)), ((-26, 4, -5), (80, -50, 630)),
    ((3, 27, 8), (70, 45, 590)), ((-4, -28, 3), (-80, -45, 650)), ((18, 20, -10), (95, -15, 700)),
    ((-20, 18, 12), (-60, -30, 560)), ((20, -22, 6), (15, 70, 690)), ((-16, -20, -14), (-10, -60, 610)),
    ((30, 8, 20), (0, 0, 660)), ((-32, -6, -20), (60, 50, 640)), ((5, 34, -3), (-70, 30, 670)),
)  # fmt: skip
"""Tilts [deg] and places [mm] of a board that somebody holds into the beam."""


@dataclass(frozen=True)
class Shot:
    """What camera and projector see of a scene.

    Attributes:
        points: Point of each pixel's ray on the surface [mm]; NaN beside it.
        projector: Pixel of the projector that lights it.
        lit: Reached by the projector's light.
        albedo: Reflectance, mean over the pixel.
        shade: Slope and distance, 1 for a surface that faces the projector at `LOOK_AT`.
    """

    points: np.ndarray
    projector: np.ndarray
    lit: np.ndarray
    albedo: np.ndarray
    shade: np.ndarray


def look(scene: Scene, rig: Rig) -> Shot:
    """Cut every ray with the surface, and follow the light from the projector."""
    seen, _ = _nearest(rig.camera, scene.vertices, scene.triangles)
    hit = seen >= 0
    corner = scene.vertices[scene.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    offset = np.einsum("ij,ij->i", normal, corner[:, 0])

    rays = rig.camera.rays()
    pitch = 1.0 / rig.camera.matrix[[0, 1], [0, 1]]

    def cut(x: float, y: float) -> np.ndarray:
        ray = rays + np.array([x * pitch[0], y * pitch[1], 0.0])
        depth = offset[seen] / np.einsum("ijk,ijk->ij", normal[seen], ray)
        return np.where(hit[..., None], depth[..., None] * ray, np.nan)

    thirds = (-1 / 3, 0.0, 1 / 3)
    albedo = np.mean([scene.albedo(cut(x, y), seen) for x in thirds for y in thirds], axis=0)
    points = cut(0.0, 0.0)
    beam = points @ rig.rotation.T + rig.translation
    pixel = np.full((*hit.shape, 2), -10.0)
    pixel[hit] = rig.projector.project(beam[hit])
    centre = -rig.rotation.T @ rig.translation
    arrow = centre - points
    length = np.linalg.norm(arrow, axis=-1)
    slope = np.abs(np.einsum("ijk,ijk->ij", normal[seen], arrow) / length)
    facing = np.einsum("ijk,ijk->ij", normal[seen], arrow) * np.einsum("ijk,ijk->ij", normal[seen], -points)
    _, buffer = _nearest(rig.projector, scene.vertices @ rig.rotation.T + rig.translation, scene.triangles)
    width, height = rig.projector.size
    column, row = (
        np.clip(np.rint(pixel[..., k]), 0, size - 1).astype(int) for k, size in ((0, width), (1, height))
    )
    inside = (pixel >= 0).all(axis=-1) & (pixel[..., 0] <= width - 1) & (pixel[..., 1] <= height - 1)
    with np.errstate(invalid="ignore"):
        lit = hit & inside & (facing > 0) & (beam[..., 2] < buffer[row, column] + 2.0 + 2.0 / (slope + 0.05))
    shade = np.where(lit, slope * (LOOK_AT / length) ** 2, 0.0)
    return Shot(points, pixel, lit, np.where(hit, albedo, 0.0), shade)


def expose(shot: Shot, pattern: np.ndarray, light: Light, random: np.random.Generator) -> np.ndarray:
    """The camera's 8-bit picture of a projected pattern."""
    beam = (pattern.astype(np.float32) / 255.0) ** light.gamma
    if light.projector_blur:
        beam = cv2.GaussianBlur(beam, (0, 0), light.projector_blur)
    x, y = (shot.projector[..., k].astype(np.float32) for k in (0, 1))
    fallen = cv2.remap(beam, x, y, cv2.INTER_LINEAR) * shot.shade
    picture = light.offset + shot.albedo * (light.ambient + light.gain * fallen)
    if light.camera_blur:
        picture = cv2.GaussianBlur(picture, (0, 0), light.camera_blur)
    picture = picture + random.standard_normal(picture.shape, dtype=np.float32) * light.noise
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def photograph(
    scene: Scene,
    rig: Rig,
    patterns: Sequence[np.ndarray],
    folder: Path,
    light: Light | None = None,
    seed: int = 0,
) -> Shot:
    """Write one picture of each pattern into a folder, numbered as a camera does."""
    shot = look(scene, rig)
    random = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    for number, pattern in enumerate(patterns):
        picture = expose(shot, pattern, light or Light(), random)
        cv2.imwrite(str(folder / f"IMG_{number:04d}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return shot


def _nearest(lens: Lens, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest triangle of every pixel, -1 without, and its depth; edges are straight between corners."""
    width, height = lens.size
    number = np.full((height, width), -1)
    depth = np.full((height, width), np.inf)
    pixel = lens.project(vertices)
    corner, inverse = pixel[triangles], 1.0 / vertices[triangles][..., 2]
    low = np.maximum(np.ceil(corner.min(axis=1)).astype(int), 0)
    high = np.minimum(np.floor(corner.max(axis=1)).astype(int), [width - 1, height - 1])
    for k in np.flatnonzero((low <= high).all(axis=1)):
        (x0, y0), (x1, y1) = low[k], high[k]
        a, b, c = corner[k]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < 1e-9:
            continue
        x, y = np.arange(x0, x1 + 1)[None, :], np.arange(y0, y1 + 1)[:, None]
        second = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
        third = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        first = 1.0 - second - third
        here = 1.0 / (first * inverse[k, 0] + second * inverse[k, 1] + third * inverse[k, 2])
        box = (slice(y0, y1 + 1), slice(x0, x1 + 1))
        inside = (np.minimum(np.minimum(first, second), third) >= -1e-9) & (here < depth[box]) & (here > 0)
        number[box][inside] = k
        depth[box][inside] = here[inside]
    return number, depth


def main() -> None:
    """Photograph a scene under the patterns of a folder."""
    parser = argparse.ArgumentParser(prog="scan_studio")
    parser.add_argument("--patterns", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--scene", choices=("leg", "board"), default="leg")
    parser.add_argument("--turn", type=float, default=0.0, help="turn of the leg [deg]")
    parser.add_argument("--wall", action="store_true", help="a wall behind the leg")
    parser.add_argument("--pose", type=int, default=0, help="pose of the board, 0 to 11")
    parser.add_argument("--board", type=Path, help="picture of the board")
    parser.add_argument("--board-mm", type=float, nargs=2, default=(210.0, 150.0))
    parser.add_argument("--camera", type=int, nargs=2, default=(960, 720))
    parser.add_argument("--gain", type=float, default=Light.gain)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    manifest = json.loads((options.patterns / "manifest.json").read_text())
    patterns = [
        cv2.imread(str(options.patterns / name), cv2.IMREAD_GRAYSCALE) for name in manifest["pictures"]
    ]
    rig = make_rig(tuple(options.camera), (manifest["width"], manifest["height"]))
    if options.scene == "leg":
        scene = leg_scene(options.turn, wall=options.wall)
    else:
        texture = cv2.imread(str(options.board), cv2.IMREAD_GRAYSCALE)
        scene = board_scene(texture, tuple(options.board_mm), *BOARD_POSES[options.pose])
    photograph(scene, rig, patterns, options.out, Light(gain=options.gain), options.seed)


if __name__ == "__main__":
    main()

"""What a DataStream says about the scene: subjects, markers, force plates, and which axis is up."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Integer

from evaluation.sources import cgstream
from evaluation.sources.cgstream import Block, Kind, Packet
from evaluation.sources.stream import PlateInfo, SourceInfo
from hilbrace.errors import InputError
from hilbrace.units import MM_PER_M

Array = np.ndarray

STATIC = {
    Kind.STREAM_INFO,
    Kind.APPLICATION_INFO,
    Kind.SUBJECT_INFO,
    Kind.DEVICE_INFO,
    Kind.DEVICE_START,
    Kind.FORCE_PLATE_INFO,
}
"""Objects that the server leaves out while they do not change."""

LOADS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
LOAD_UNITS = ("N", "N", "N", "N*m", "N*m", "N*m")

LOADED_N = 50.0
"""Vertical force above which a centre of pressure means something."""


@dataclass
class Scene:
    """What the static objects said last; `missing` if one of them was lost on the way."""

    objects: dict[int, list[bytes]] = field(default_factory=dict)
    samples: dict[int, int] = field(default_factory=dict)
    period_s: float = math.nan
    up: str = "z"
    labels: tuple[str, ...] = ()
    keys: Integer[Array, " marker"] = field(default_factory=lambda: np.zeros(0, np.uint64))
    columns: Integer[Array, " marker"] = field(default_factory=lambda: np.zeros(0, int))
    devices: dict[int, tuple[float, str]] = field(default_factory=dict)
    starts: dict[int, float] = field(default_factory=dict)
    plates: dict[int, cgstream.Plate] = field(default_factory=dict)
    missing: bool = False

    def update(self, packet: Packet) -> bool:
        """Take over what a frame says anew; true if it was news."""
        present, unchanged = STATIC, set()
        new: dict[int, list[bytes]] = {}
        for kind, payload in packet:
            if kind == Kind.CONTENTS:
                present, unchanged = cgstream.read_contents(payload)
            elif kind in STATIC:
                new.setdefault(kind, []).append(payload)
        kept = {kind: old for kind, old in self.objects.items() if kind in unchanged and kind in present}
        objects = {**kept, **new}
        self.missing = bool((unchanged & present & STATIC) - objects.keys())
        if objects == self.objects:
            return False
        self._interpret(objects)
        self.objects = objects
        return True

    def count_samples(self, blocks: list[Block]) -> bool:
        """Learn how many samples a device sends at once; true if it was news."""
        seen = {block.device: len(block.values) for block in blocks if len(block.values)}
        if all(self.samples.get(device) == count for device, count in seen.items()):
            return False
        self.samples.update(seen)
        return True

    def positions(self, payload: bytes) -> Float[Array, "marker 3"]:
        """Markers in the order of the labels [m]; NaN where occluded."""
        out = np.full((len(self.labels), 3), np.nan)
        keys, places = cgstream.read_labelled(payload)
        if not len(self.keys) or not len(keys):
            return out
        found = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        known = self.keys[found] == keys
        out[self.columns[found[known]]] = places[known] / MM_PER_M
        return out

    def _interpret(self, objects: dict[int, list[bytes]]) -> None:
        for payload in objects.get(Kind.STREAM_INFO, []):
            self.period_s = cgstream.read_period(payload)
        for payload in objects.get(Kind.APPLICATION_INFO, []):
            self.up = "y" if payload[:1] == b"\x01" else "z"
        devices = [cgstream.read_device(payload) for payload in objects.get(Kind.DEVICE_INFO, [])]
        plates = [cgstream.read_plate(payload) for payload in objects.get(Kind.FORCE_PLATE_INFO, [])]
        self.devices = {number: (period, name) for number, period, name in devices}
        self.starts = dict(
            cgstream.read_device_start(payload) for payload in objects.get(Kind.DEVICE_START, [])
        )
        self.plates = {plate.device: plate for plate in plates}
        self._name_markers([cgstream.read_subject(payload) for payload in objects.get(Kind.SUBJECT_INFO, [])])

    def _name_markers(self, subjects: list[cgstream.Subject]) -> None:
        prefixed = len(subjects) > 1
        markers = [(s, number, name) for s in subjects for number, name in s.markers.items()]
        self.labels = tuple(f"{s.name}:{name}" if prefixed else name for s, _, name in markers)
        numbers = np.array([(s.number, number) for s, number, _ in markers], np.uint64).reshape(-1, 2)
        keys = cgstream.marker_key(numbers[:, 0], numbers[:, 1])
        self.columns = np.argsort(keys)
        self.keys = keys[self.columns]

    def info(self, source: str, address: str) -> SourceInfo:
        """What the source delivers."""
        plates = [
            plate_info(name, self.samples.get(number, 0) / block_s, self.plates[number])
            for number, (block_s, name) in self.devices.items()
            if number in self.plates and block_s > 0
        ]
        notes = () if self.labels else ("No labelled markers: enable a subject in Nexus or Tracker.",)
        up = "y" if self.up == "y" else "z"
        device = f"Vicon DataStream at {address}"
        return SourceInfo(source, device, self.labels, 1.0 / self.period_s, up, tuple(plates), notes)


def check_labels(info: SourceInfo, where: str) -> None:
    """Refuse two markers of one name.

    Raises:
        InputError: There are.
    """
    twice = sorted({label for label in info.labels if info.labels.count(label) > 1})
    if twice:
        raise InputError(
            f"two markers are called '{twice[0]}'",
            where=where,
            hint="rename one, or disable one of the subjects",
        )


def centre_error(
    force: Float[Array, "sample 3"], moment: Float[Array, "sample 3"], centre: Float[Array, "sample 3"]
) -> float:
    """Distance between a stated centre of pressure and the one that force and moment make [m]; NaN unloaded.

    Args:
        force: Force on the plate in its axes [N].
        moment: Moment about its origin [N*m].
        centre: Centre of pressure that the server states [m].
    """
    loaded = np.asarray(np.abs(force[:, 2]) > LOADED_N)
    if not loaded.any():
        return math.nan
    lever = np.column_stack([-moment[loaded, 1], moment[loaded, 0]]) / force[loaded, 2:]
    return float(np.median(np.linalg.norm(lever - centre[loaded, :2], axis=1)))


def plate_info(name: str, rate_hz: float, plate: cgstream.Plate) -> PlateInfo:
    """A plate whose loads are those on it, in its own axes and about its origin."""
    low, high = plate.low, plate.high
    local = np.array([[high[0], high[1]], [low[0], high[1]], [low[0], low[1]], [high[0], low[1]]], float)
    surface = np.column_stack([local, np.full(4, high[2])])
    origin = plate.translation / MM_PER_M
    corners = origin + surface @ plate.rotation.T / MM_PER_M
    return PlateInfo(
        name, rate_hz, LOADS, LOAD_UNITS, -np.eye(6), plate.rotation, origin, corners, zeroed=True
    )

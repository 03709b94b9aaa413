"""Frames, samples and events as JSON messages, and back, without loss.

Every number is the one that the device sent; whatever is no number (an occluded marker, an unknown time) is
``null``.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from evaluation.sources.stream import (
    EventKind,
    Item,
    MarkerFrame,
    PlateInfo,
    PlateSamples,
    SourceEvent,
    SourceInfo,
)

MarkKind = Literal["start", "condition", "standing", "zero", "note", "lost", "recovered", "stop"]
"""``lost``: the recorder itself had to drop items; ``recovered``: the file was cut and mended."""

NUMBER = {"type": ["number", "null"]}
WHOLE = {"type": "integer"}
TEXT = {"type": "string"}
_TIMES = {"device_time_s": NUMBER, "host_time_ns": WHOLE}


@dataclass(frozen=True)
class Mark:
    """Something that the operator or the recorder wrote into the recording.

    Attributes:
        kind: What it says.
        host_time_ns: ``time.monotonic_ns()`` [ns].
        text: The name of the condition, or a sentence.
        content: Whatever else belongs to it.
    """

    kind: MarkKind
    host_time_ns: int
    text: str
    content: dict[str, Any]


def topic(item: Item | Mark) -> str:
    """Where viewers list the messages of an item."""
    match item:
        case Mark():
            return "/session"
        case SourceInfo():
            return f"/{item.source}/info"
        case MarkerFrame():
            return f"/{item.source}/markers"
        case PlateSamples():
            return f"/{item.source}/{item.plate}"
        case SourceEvent():
            return f"/{item.source}/events"


def describe(item: Item | Mark, info: SourceInfo | None) -> tuple[dict[str, Any], dict[str, str]]:
    """JSON schema and metadata of the channel that holds an item.

    Args:
        item: First item of the channel.
        info: What its source said it delivers.
    """
    match item:
        case Mark():
            fields = {"kind": TEXT, "host_time_ns": WHOLE, "text": TEXT, "content": {"type": "object"}}
            return _schema("mark", fields), {"kind": "mark"}
        case SourceInfo():
            fields = {"device": TEXT, "labels": {"type": "array"}, "rate_hz": NUMBER, "up": TEXT,
                      "plates": {"type": "array"}, "notes": {"type": "array"}}  # fmt: skip
            return _schema("info", fields), {"kind": "info", "source": item.source}
        case MarkerFrame():
            place = {"type": ["array", "null"], "items": {"type": "number"}, "description": "x, y, z [m]"}
            fields = {
                "frame": WHOLE,
                **_TIMES,
                "markers": _object(dict.fromkeys(labels_of(info, item), place)),
            }
            return _schema("markers", fields), {"kind": "markers", "source": item.source}
        case PlateSamples():
            plate = plate_of(info, item.plate)
            units = dict(zip(plate.channels, plate.units, strict=True)) if plate else {}
            fields = {
                name: {"type": "array", "items": NUMBER, "description": f"[{units.get(name, '')}]"}
                for name in channels_of(plate, item)
            }
            every = {"sample": WHOLE, **_TIMES, "period_s": NUMBER, "channels": _object(fields)}
            return _schema("plate", every), {"kind": "plate", "source": item.source, "plate": item.plate}
        case SourceEvent():
            fields = {"kind": TEXT, **_TIMES, "text": TEXT, "lost": WHOLE, "plate": TEXT}
            return _schema("event", fields), {"kind": "event", "source": item.source}


def plate_of(info: SourceInfo | None, name: str) -> PlateInfo | None:
    """The plate of a name, if its source announced it."""
    return next((plate for plate in info.plates if plate.name == name), None) if info else None


def labels_of(info: SourceInfo | None, frame: MarkerFrame) -> tuple[str, ...]:
    """Names of the markers of a frame; numbers where its source announced none that fit."""
    count = len(frame.positions)
    if info is not None and len(info.labels) == count:
        return info.labels
    return tuple(f"marker_{k + 1}" for k in range(count))


def channels_of(plate: PlateInfo | None, item: PlateSamples) -> tuple[str, ...]:
    """Names of the channels of some samples; numbers where their source announced none that fit."""
    count = item.values.shape[1]
    return (
        plate.channels
        if plate and len(plate.channels) == count
        else tuple(f"channel_{k + 1}" for k in range(count))
    )


def encode(item: Item | Mark, info: SourceInfo | None) -> bytes:
    """An item as JSON; `decode` gives it back.

    Args:
        item: The item.
        info: What its source said it delivers.
    """
    match item:
        case Mark():
            content = {"kind": item.kind, "host_time_ns": item.host_time_ns, "text": item.text,
                       "content": item.content}  # fmt: skip
        case SourceInfo():
            content = _info(item)
        case MarkerFrame():
            seen = np.asarray(np.isfinite(item.positions).all(axis=1)).tolist()
            places = [
                place if known else None
                for place, known in zip(item.positions.tolist(), seen, strict=True)
            ]  # fmt: skip
            content = {
                "frame": item.number,
                "device_time_s": _number(item.device_time_s),
                "host_time_ns": item.host_time_ns,
                "markers": dict(zip(labels_of(info, item), places, strict=True)),
            }
        case PlateSamples():
            names = channels_of(plate_of(info, item.plate), item)
            content = {
                "sample": item.number,
                "device_time_s": _number(item.device_time_s),
                "host_time_ns": item.host_time_ns,
                "period_s": item.period_s,
                "channels": dict(zip(names, _numbers(item.values.T), strict=True)),
            }
        case SourceEvent():
            content = {
                "kind": item.kind,
                "device_time_s": _number(item.device_time_s),
                "host_time_ns": item.host_time_ns,
                "text": item.text,
                "lost": item.lost,
                "plate": item.plate,
            }
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode()


def decode(content: bytes, metadata: dict[str, str]) -> Item | Mark:
    """The item of a message.

    Args:
        content: The message.
        metadata: The channel's.

    Raises:
        ValueError: The message is none that `encode` writes.
        KeyError: It lacks a field.
    """
    fields = json.loads(content)
    source = metadata.get("source", "")
    match metadata.get("kind"):
        case "mark":
            return Mark(_one_of(MarkKind, fields["kind"]), fields["host_time_ns"], fields["text"],
                        fields["content"])  # fmt: skip
        case "info":
            return _info_from(source, fields)
        case "markers":
            places = [[math.nan] * 3 if place is None else place for place in fields["markers"].values()]
            return MarkerFrame(source, fields["frame"], _float(fields["device_time_s"]),
                               fields["host_time_ns"], np.array(places, float).reshape(-1, 3))  # fmt: skip
        case "plate":
            columns = list(fields["channels"].values())
            return PlateSamples(source, metadata["plate"], fields["sample"], _float(fields["device_time_s"]),
                                fields["period_s"], fields["host_time_ns"],
                                np.array(columns, float).T.reshape(-1, len(columns)))  # fmt: skip
        case "event":
            return SourceEvent(source, _one_of(EventKind, fields["kind"]), fields["host_time_ns"],
                               _float(fields["device_time_s"]), fields["text"], fields["lost"],
                               fields["plate"])  # fmt: skip
    raise ValueError(f"unknown kind of message '{metadata.get('kind')}'")


def _info(info: SourceInfo) -> dict[str, Any]:
    plates = [
        {
            "name": plate.name,
            "rate_hz": plate.rate_hz,
            "channels": plate.channels,
            "units": plate.units,
            "calibration": plate.calibration.tolist(),
            "rotation": plate.rotation.tolist(),
            "origin": plate.origin.tolist(),
            "corners": _numbers(plate.corners),
            "zeroed": plate.zeroed,
            "noise_n": plate.noise_n,
            "empty": plate.empty,
        }
        for plate in info.plates
    ]
    return {"device": info.device, "labels": info.labels, "rate_hz": info.rate_hz, "up": info.up,
            "plates": plates, "notes": info.notes}  # fmt: skip


def _info_from(source: str, fields: dict[str, Any]) -> SourceInfo:
    plates = tuple(
        PlateInfo(
            name=plate["name"],
            rate_hz=plate["rate_hz"],
            channels=tuple(plate["channels"]),
            units=tuple(plate["units"]),
            calibration=np.array(plate["calibration"], float),
            rotation=np.array(plate["rotation"], float),
            origin=np.array(plate["origin"], float),
            corners=np.array([[_float(value) for value in corner] for corner in plate["corners"]]),
            zeroed=plate["zeroed"],
            noise_n=plate.get("noise_n", PlateInfo.noise_n),
            empty=tuple(plate.get("empty", ())),
        )
        for plate in fields["plates"]
    )
    return SourceInfo(source, fields["device"], tuple(fields["labels"]), fields["rate_hz"], fields["up"],
                      plates, tuple(fields["notes"]))  # fmt: skip


def _schema(title: str, fields: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, **_object(fields)}


def _object(fields: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": fields}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _numbers(values: np.ndarray) -> list[list[float | None]]:
    """Rows of numbers; counts as whole ones, which take a third of the room."""
    rows = values.tolist()
    if not np.isfinite(values).all():
        return [[_number(value) for value in row] for row in rows]
    if (values == np.rint(values)).all() and np.abs(values).max(initial=0.0) < 2**53:
        return np.rint(values).astype(int).tolist()
    return rows


def _float(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _one_of(kinds: Any, value: str) -> Any:
    if value not in get_args(kinds):
        raise ValueError(f"'{value}' is none of {', '.join(get_args(kinds))}")
    return value

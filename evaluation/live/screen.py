"""What a session looks like on a screen: everything but the curves, as JSON knows it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from evaluation.live.health import DeviceHealth
from evaluation.live.peaks import Peak
from evaluation.live.session import LabSession


def session_state(session: LabSession) -> dict[str, Any]:
    """State of a session now: angles, forces, peaks, tally, recording, devices, losses, delays.

    Args:
        session: The session.
    """
    readings, health = session.analysis.readings(), session.acquisition.health()
    return {
        "study": session.settings.name,
        "subject": session.settings.subject,
        "synthetic": session.settings.synthetic,
        "side": session.settings.protocol.side,
        "knee_deg": None if readings.knee_deg is None else [round(angle, 2) for angle in readings.knee_deg],
        "force_n": None if readings.force_n is None else round(readings.force_n, 1),
        "residual_mm": _finite(readings.residual_mm),
        "hidden": readings.hidden,
        "fault": readings.fault,
        "take": {
            "bending": _peak(readings.bending),
            "landing": _peak(readings.landing),
            "deepest": _peak(readings.deepest),
        },
        "condition": session.condition,
        "conditions": session.settings.names,
        "tally": [
            {
                "condition": row.condition,
                "takes": row.takes,
                "bending": _peak(row.bending),
                "landing": _peak(row.landing),
            }
            for row in session.tally()
        ],
        "recording": _recording(session),
        "busy": session.busy,
        "devices": [_device(device) for device in health],
        "loss": losses(session),
        "latency_ms": {
            "p50": _finite(session.analysis.latency.percentile(50)),
            "p99": _finite(session.analysis.latency.percentile(99)),
            "recent_p99": _finite(session.analysis.latency.recent(99)),
        },
    }


def losses(session: LabSession) -> dict[str, int]:
    """What was received, lost by the devices' counters, and dropped by this program.

    Args:
        session: The session.
    """
    health, acquisition = session.acquisition.health(), session.acquisition
    return {
        "received": sum(device.frames + device.samples for device in health),
        "lost": sum(device.lost for device in health),
        "dropped": acquisition.recorder.mailbox.dropped + acquisition.analysis.dropped,
    }


def _recording(session: LabSession) -> dict[str, Any]:
    recorder = session.acquisition.recorder
    on, written = recorder.recording, recorder.written
    return {
        "on": on,
        "of": session.recording_of,
        "file": written.path.name if written else "",
        "seconds": round(session.seconds, 1) if on else 0.0,
        "frames": written.frames if written and on else 0,
        "fault": recorder.fault,
    }


def _device(device: DeviceHealth) -> dict[str, Any]:
    drift, error = device.drift_ppm, device.drift_error_ppm
    return asdict(device) | {
        "rate_hz": round(device.rate_hz, 1),
        "drift_ppm": None if drift is None else round(drift, 1),
        "drift_error_ppm": None if error is None else round(error, 1),
    }


def _peak(peak: Peak | None) -> dict[str, float] | None:
    if peak is None:
        return None
    return {"flexion_deg": round(peak.flexion_deg, 1), "adduction_deg": round(peak.adduction_deg, 1)}


def _finite(value: float) -> float | None:
    return round(value, 2) if value == value else None

"""``hilbrace evaluate live | record | recover | devices``."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from pathlib import Path
from typing import Any

from hilbrace.errors import ConfigError

LAB_EXAMPLE = """\
a lab.toml:
  name = "Knee braces"
  subject = "S01"
  devices = ["vicon://192.168.1.10", "serial:///dev/ttyUSB0?calibration=plate.toml"]
  baseline = "Unbraced"

  [[conditions]]
  name = "Unbraced"
  [[conditions]]
  name = "Optimized"

  [protocol]
  side = "left"
  hip = { model = "trochanter", trochanter_width_m = 0.32 }

addresses of devices:
  vicon://192.168.1.10:801                      Vicon DataStream
  qualisys://192.168.1.11                       Qualisys QTM, real-time server
  serial:///dev/ttyUSB0?protocol=cobs&calibration=plate.toml     self-built plate (docs/serial_plate.md)
  amti:///dev/ttyS0?calibration=plate.acl&units=lb, in*lb        AMTI plate, RS-232
  lsl://ForcePlate                              Lab Streaming Layer
  c3d:///recordings/trial.c3d                   replay of a recording
  ?name=left names a device; &x=0.3&y=0.2&heading=90 place a plate in the laboratory [m, deg]
"""

RECORDINGS = "recordings"

SAY_EVERY_S = 1.0


def add_live_commands(commands: Any, command: Any) -> None:
    """Add the commands of the live laboratory.

    Args:
        commands: Where ``hilbrace evaluate`` collects its commands.
        command: Makes a command from its name, action, text and example.
    """
    live = command(
        commands, "live", _live, "knee angles on a screen while the athlete moves; takes survive a crash",
        "hilbrace evaluate live lab.toml --out monday",
    )  # fmt: skip
    live.epilog += "\n\n" + LAB_EXAMPLE
    live.formatter_class = argparse.RawDescriptionHelpFormatter
    live.add_argument("lab", type=Path, metavar="lab.toml", help="devices, leg, markers, brace conditions")
    live.add_argument(
        "--device",
        action="append",
        default=[],
        metavar="ADDRESS",
        help="a device; replaces those of the file; may be repeated",
    )
    live.add_argument(
        "--out", type=Path, metavar="DIR", help=f"folder of takes (default: {RECORDINGS}, beside the file)"
    )
    live.add_argument(
        "--port", type=int, default=8765, metavar="N", help="port of the page (default: 8765; 0: any free)"
    )
    _common_options(live)

    record = command(
        commands, "record", _record, "record devices to one MCAP file that survives a crash",
        "hilbrace evaluate record vicon://192.168.1.10 --out walk.mcap --seconds 10",
    )  # fmt: skip
    record.epilog += "; exit code 1 says that a device or this computer lost something"
    record.add_argument("devices", nargs="+", metavar="ADDRESS", help="devices, as vicon://192.168.1.10")
    record.add_argument(
        "--out",
        type=Path,
        default=Path("take.mcap"),
        metavar="FILE.mcap",
        help="the recording (default: take.mcap); the next free name if it exists",
    )
    record.add_argument("--condition", metavar="NAME", help="brace condition to note in the recording")
    record.add_argument(
        "--stomps",
        metavar="MARKER",
        help="marker on the heel whose stomps tell the clock of a plate with a clock of its own",
    )
    record.add_argument("--c3d", action="store_true", help="write a C3D file beside it")
    _common_options(record)

    recover = command(
        commands, "recover", _recover, "mend a recording that a crash cut, and say what it lacks",
        "hilbrace evaluate recover take.mcap --c3d",
    )  # fmt: skip
    recover.add_argument("recording", type=Path, metavar="FILE.mcap", help="the recording; it is not touched")
    recover.add_argument(
        "--out", type=Path, metavar="FILE.mcap", help="the clean file (default: FILE_recovered.mcap)"
    )
    recover.add_argument("--c3d", action="store_true", help="write a C3D file beside the clean one")
    recover.add_argument("--json", action="store_true", help="one JSON object on standard output")

    devices = command(
        commands, "devices", _devices, "list serial ports, and test the connection to devices",
        "hilbrace evaluate devices vicon://192.168.1.10 qualisys://192.168.1.11",
    )  # fmt: skip
    devices.add_argument("devices", nargs="*", metavar="ADDRESS", help="devices to test; none lists ports")
    devices.add_argument("--probe", action="store_true", help="ask each serial port which plate is there")
    devices.add_argument(
        "--seconds", type=float, default=2.0, metavar="S", help="length of a test (default: 2)"
    )
    devices.add_argument("--json", action="store_true", help="one JSON object on standard output")


def _common_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--seconds", type=float, metavar="S", help="end after this time (default: Ctrl-C ends)"
    )
    command.add_argument("--json", action="store_true", help="one JSON object on standard output, at the end")


def _live(options: argparse.Namespace) -> int:
    from evaluation.dashboard.server import Dashboard
    from evaluation.live.screen import session_state
    from evaluation.live.session import LabSession
    from evaluation.live.settings import read_lab
    from evaluation.sources.addresses import open_addresses

    settings = read_lab(options.lab)
    addresses = options.device or settings.devices
    if not addresses:
        raise ConfigError(
            "no device is named", where=str(options.lab), hint="add 'devices' to the file, or give --device"
        )
    folder = options.out or options.lab.resolve().parent / RECORDINGS
    session = LabSession(settings, folder, open_addresses(addresses))
    page = Dashboard(session, options.port)
    page.start()
    try:
        session.start()
        sys.stderr.write(f"open {page.url}   (Ctrl-C ends)\n")
        _wait(options.seconds)
    finally:
        page.stop()
        state = session_state(session)
        session.stop()
    summary = {
        "folder": str(folder),
        "takes": [{"condition": take.condition, "recording": str(take.log), "c3d": str(take.c3d),
                   "notes": list(take.notes)} for take in session.takes],
        "loss": state["loss"],
        "latency_ms": state["latency_ms"],
        "devices": state["devices"],
        "study": str(session.study.path) if session.study.path.exists() else None,
        "fault": session.fault,
    }  # fmt: skip
    lost, dropped = state["loss"]["lost"], state["loss"]["dropped"]
    _tell(
        summary,
        f"{len(session.takes)} takes in {folder}; {lost} samples lost by devices, {dropped} by this computer"
        + (f"\n{session.fault}" if session.fault else ""),
        options.json,
    )
    return 0


def _record(options: argparse.Namespace) -> int:
    from evaluation.live.acquisition import Acquisition, Answer, Begin, End, Note
    from evaluation.sources.addresses import open_addresses

    acquisition = Acquisition(open_addresses(options.devices), analyse=False)
    acquisition.connect()
    begun = Answer()
    content: dict[str, Any] = {"devices": options.devices}
    if options.stomps:
        content["stomps"] = options.stomps
    recorder = acquisition.recorder
    recorder.mailbox.order(Begin(options.out, content, begun))
    if options.condition:
        recorder.mailbox.order(Note("condition", options.condition, {}))
    acquisition.start()
    ended = Answer()
    try:
        path = begun.wait().path
        _say(f"recording {path}   (Ctrl-C ends)", options.json)
        _wait(options.seconds, lambda: _over(acquisition))
    finally:
        recorder.mailbox.order(End(ended))
        ended.done.wait(10.0)
        health = acquisition.health()
        acquisition.stop()
    written = ended.wait()
    content = {
        "recording": str(written.path),
        "seconds": round(written.seconds, 3),
        "bytes": written.bytes,
        "frames": written.frames,
        "samples": written.samples,
        "lost": written.lost,
        "dropped": written.dropped,
        "devices": [
            {
                "name": device.name,
                "state": device.state,
                "lost": device.lost,
                "drift_ppm": device.drift_ppm,
                "drift_error_ppm": device.drift_error_ppm,
            }
            for device in health
        ],
    }
    text = [
        f"{written.path}: {written.frames} frames, {written.samples} plate samples, {written.lost} lost, "
        f"{written.dropped} dropped"
    ]
    if options.c3d:
        content["c3d"], content["notes"] = _convert(written.path)
        text += [f"{content['c3d']}", *(f"- {note}" for note in content["notes"])]
    _tell(content, "\n".join(text), options.json)
    return 0 if written.lost + written.dropped == 0 else 1


def _recover(options: argparse.Namespace) -> int:
    from evaluation.record.recover import recover

    found = recover(options.recording, options.out)
    content: dict[str, Any] = {
        "recording": str(options.recording),
        "recovered": str(found.path),
        "finished": found.finished,
        "seconds": round(found.seconds, 3),
        "frames": found.frames,
        "samples": found.samples,
        "missing": found.missing,
        "discarded_bytes": found.discarded_bytes,
        "damaged_chunks": found.damaged_chunks,
        "gaps": list(found.gaps),
    }
    state = "was closed as it should" if found.finished else "was cut"
    text = [
        f"{options.recording} {state}: {found.frames} frames, {found.samples} plate samples, "
        f"{found.seconds:.3f} s",
        *(f"- {gap}" for gap in found.gaps),
        f"clean   {found.path}",
    ]
    if options.c3d:
        content["c3d"], content["notes"] = _convert(found.path)
        text += [f"C3D     {content['c3d']}", *(f"- {note}" for note in content["notes"])]
    _tell(content, "\n".join(text), options.json)
    return 0


def _devices(options: argparse.Namespace) -> int:
    from evaluation.device_check import check_devices, probe_ports
    from evaluation.sources.serial_port import serial_ports

    ports = [{"port": port.path, "text": port.description or "serial port"} for port in serial_ports()]
    content: dict[str, Any] = {"ports": ports}
    text = [f"{port['port']}   {port['text']}" for port in ports] or ["no serial port on this computer"]
    if options.probe:
        content["found"] = probe_ports([port["port"] for port in ports])
        text += [f"{entry['port']}: {entry['text']}" for entry in content["found"]]
    answers = True
    if options.devices:
        checks = check_devices(options.devices, options.seconds)
        content["devices"] = checks
        answers = all(check["answers"] for check in checks)
        text = [f"{check['address']}: {check['text']}" for check in checks]
    _tell(content, "\n".join(text), options.json)
    return 0 if answers else 7


def _convert(recording: Path) -> tuple[str, list[str]]:
    from evaluation.record.conversion import convert
    from evaluation.record.reading import read_log

    path, notes = convert(read_log(recording), recording.with_suffix(".c3d"))
    return str(path), list(notes)


def _over(acquisition: Any) -> bool:
    """Whether every device has ended or needs a person."""
    return all(device.state in ("ended", "fault") for device in acquisition.health())


def _wait(seconds: float | None, over: Any = None) -> None:
    """Wait for the time to pass, for all devices to end, for Ctrl-C, or to be told to end."""
    end = None if seconds is None else time.monotonic() + seconds
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        while (end is None or time.monotonic() < end) and not (over is not None and over()):
            time.sleep(0.05)
    except KeyboardInterrupt:
        return
    finally:
        signal.signal(signal.SIGTERM, before)


def _tell(content: dict[str, Any], text: str, as_json: bool) -> None:
    sys.stdout.write((json.dumps(content) if as_json else text) + "\n")
    sys.stdout.flush()


def _say(text: str, as_json: bool) -> None:
    if not as_json:
        sys.stderr.write(text + "\n")

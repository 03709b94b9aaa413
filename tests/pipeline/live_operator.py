"""Measures a study live, as an operator at the page would: python -m tests.pipeline.live_operator STUDY OUT.

A Vicon system in a process of its own plays the study's files, frame by frame when told to, so that each
take holds just the frames of its file. Prints the tally and the notes of the takes as JSON.
"""

from __future__ import annotations

import functools
import json
import math
import sys
import tomllib
from dataclasses import asdict
from pathlib import Path

from evaluation.live import acquisition
from evaluation.live.session import LabSession
from evaluation.live.settings import LabSettings
from evaluation.measure import measure_study
from evaluation.results import evaluate
from evaluation.sources.addresses import open_addresses
from evaluation.sources.reconnecting import Reconnecting
from evaluation.study import read_study
from evaluation.tables import table_json
from tests.pipeline.live_mocks import Mock, vicon, wait_for

STANDING_FRAMES = 400


class Player:
    """Lets the mock send frames, and waits until they have all been analysed."""

    def __init__(self, mock: Mock, session: LabSession) -> None:
        self.mock, self.session, self.sent = mock, session, 1

    def play(self, frames: int) -> None:
        self.sent += frames
        self.mock.advance(frames)
        wait_for(lambda: self.session.analysis.frames >= self.sent)


def settings_of(document: dict) -> LabSettings:
    conditions = [{"name": c["name"], "published": c["published"]} for c in document["conditions"]]
    kept = {key: document[key] for key in ("name", "subject", "synthetic", "baseline", "protocol")}
    return LabSettings.model_validate(kept | {"conditions": conditions})


def measure(study: Path, folder: Path, frames: int) -> dict:
    document = tomllib.loads(study.read_text("utf-8"))
    trials = [str(study.parent / name) for c in document["conditions"] for name in c["trials"]]
    standing = str(study.parent / document["standing"])
    # The mock waits while a take is converted, and that is no silence to give up at.
    acquisition.Reconnecting = functools.partial(Reconnecting, silence_s=math.inf)
    with vicon(standing, standing, *trials, "--patient", "--speed", "1e6") as mock:
        session = LabSession(settings_of(document), folder, open_addresses([mock.address]))
        session.start()
        player = Player(mock, session)
        try:
            player.play(STANDING_FRAMES - 1)
            calibrated = session.record_standing()
            player.play(STANDING_FRAMES)
            calibrated.result(60)
            for condition in document["conditions"]:
                session.choose_condition(condition["name"])
                for _ in condition["trials"]:
                    session.begin_take()
                    player.play(frames)
                    session.end_take()
            tally = [asdict(row) for row in session.tally()]
        finally:
            session.stop()
    notes = [list(take.notes) for take in session.takes]
    return {"tally": tally, "notes": notes, "live": table(folder / "study.toml"), "files": table(study)}


def table(study: Path) -> list[dict]:
    """The cells that ``hilbrace evaluate table`` prints, without its figures."""
    return table_json(evaluate(measure_study(read_study(study)), 0))["cells"]


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measure(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))) + "\n")

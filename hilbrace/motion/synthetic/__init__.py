"""The built-in synthetic subject: whole-body motions with exactly known coordinates and ground reactions."""

from __future__ import annotations

from hilbrace.motion.synthetic.generate import StaticTrial, SyntheticMotion, generate
from hilbrace.motion.synthetic.recording import write_recording

__all__ = ["StaticTrial", "SyntheticMotion", "generate", "write_recording"]

"""The motioncapture wheel, with Vicon's own SDK in it, as a client: positions of one body, frame by frame.

It runs in a process of its own. After each frame it writes a line to standard output, which lets the mock go
on; at the end it saves the positions [m] and the orientations (quaternions, w last).
"""

from __future__ import annotations

import sys
import time

import motioncapture
import numpy as np


def main() -> None:
    port, frames, path = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    system = motioncapture.connect("vicon", {"hostname": f"127.0.0.1:{port}"})
    positions, turns, times = [], [], []
    while len(positions) < frames:
        system.waitForNextFrame()
        bodies = system.rigidBodies
        sys.stdout.write("\n")
        sys.stdout.flush()
        if "Limb" in bodies:
            body = bodies["Limb"]
            positions.append(np.array(body.position))
            turns.append([getattr(body.rotation, axis) for axis in "xyzw"])
            times.append(time.monotonic())
    np.savez(path, positions=positions, turns=turns, times=times)


if __name__ == "__main__":
    main()

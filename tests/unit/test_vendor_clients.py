"""The vendors' own code accepts our mocks: 2,000 frames at 200 Hz without a gap, Vicon and Qualisys."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocks import scene
from mocks.vicon_server import SEGMENT_TURN
from tests.unit.mock_process import mock

FRAMES = 2000
CLIENT = Path(__file__).with_name("motioncapture_client.py")


@pytest.fixture(scope="module")
def content():
    return scene.synthetic()


@pytest.mark.slow
def test_vicons_own_sdk_receives_every_pose(content, tmp_path):
    if importlib.util.find_spec("motioncapture") is None:
        pytest.skip("the motioncapture wheel is not installed")
    taken, take = os.pipe()
    out = tmp_path / "poses.npz"
    try:
        with mock("vicon_server", "--patient", stdin=taken) as port:
            command = [sys.executable, str(CLIENT), str(port), str(FRAMES), str(out)]
            subprocess.run(command, stdout=take, timeout=120, check=True)
    finally:
        os.close(taken)
        os.close(take)
    with np.load(out) as poses:
        positions, turns, times = poses["positions"], poses["turns"], poses["times"]
    seen = np.isfinite(content.positions).all(axis=2, keepdims=True)
    roots = np.where(seen, content.positions, 0).sum(axis=1) / seen.sum(axis=1)
    first = int(np.abs(roots - positions[0]).max(axis=1).argmin())
    expected = roots[(first + np.arange(FRAMES)) % len(roots)]
    assert np.abs(np.diff(roots, axis=0)).max(axis=1).min() > 1e-6
    np.testing.assert_allclose(positions, expected, atol=1e-6)
    np.testing.assert_allclose(Rotation.from_quat(turns).as_matrix(), [SEGMENT_TURN] * FRAMES, atol=1e-6)
    assert times[-1] - times[0] > 0.99 * (FRAMES - 1) / 200


@pytest.mark.slow
def test_qualisys_own_client_streams_markers_and_forces(content):
    qtm_rt = pytest.importorskip("qtm_rt")
    got = []

    async def receive(port: int) -> None:
        done = asyncio.Event()

        def take(packet) -> None:
            got.append(
                (packet.framenumber, packet.timestamp, packet.get_3d_markers()[1], packet.get_force()[1])
            )
            if len(got) >= FRAMES:
                done.set()

        connection = await qtm_rt.connect("127.0.0.1", port=port, version="1.25")
        assert b"QTM Version" in await connection.qtm_version()
        assert (await connection.get_state()).name == "EventConnected"
        assert b"<Name>TH1</Name>" in await connection.get_parameters(["3d", "force"])
        assert await connection.stream_frames(components=["3d", "force"], on_packet=take) == b"Ok"
        await asyncio.wait_for(done.wait(), 60)
        connection.disconnect()
        await asyncio.sleep(0)

    with mock("qualisys_server") as port:
        asyncio.run(receive(port))
    numbers = np.array([number for number, *_ in got[:FRAMES]])
    assert (np.diff(numbers) == 1).all()
    np.testing.assert_array_equal([stamp for _, stamp, *_ in got[:FRAMES]], numbers * 5000)
    markers = 1e-3 * np.array([places for *_, places, _ in got[:FRAMES]])
    at = numbers % len(content)
    np.testing.assert_allclose(markers, content.positions[at], atol=1e-6)
    assert np.isnan(markers).any()
    plates = [plates[0] for *_, plates in got[:FRAMES]]
    assert [plate.force_number for plate, _ in plates] == (5 * numbers).tolist()
    forces = np.array([samples for _, samples in plates])
    np.testing.assert_allclose(forces[:, :, :6], content.loads[at], atol=1e-3)

"""`make blender-test`: the Blender extension in a Blender of its own, against decoded pictures. Minutes, no GPU.

    python tests/blender/render.py PYTHON EXTENSION.zip FOLDER

PYTHON is one with bpy. Encodes the sample rig at half size, decodes the first and the last frame, and has
`in_blender.py` render them. The limits: 25 dB, a mean level within 3, a camera upright within 15 degrees.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder import decode, export, open_stream
from decogs.decoder.cameras.pose_file import read_free_cameras
from decogs.decoder.editing import Crop, Sphere, Transform, Trim, edit
from decogs.encoder import EncodeJob, encode

sys.path.insert(0, str(Path(__file__).parents[1]))
from packets import with_header

RIG = Path(__file__).parents[1] / "demo" / "workbench"
FRAMES = 6
"""More than a segment of the USD export has, so that there is a group at rest, too."""
LEAST_DB, MOST_LEVELS, LEAST_UP = 25.0, 3.0, np.cos(np.radians(15))


def picture(path: Path) -> NDArray[np.float64]:
    read = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert read is not None, f"{path}: is no picture"
    return read.astype(np.float64)


def compare(name: str, rendered: Path, decoded: Path) -> None:
    ours, theirs = picture(rendered), picture(decoded)
    error = float(((ours - theirs) ** 2).mean())
    decibels, levels = 10 * np.log10(255**2 / error), ours.mean() - theirs.mean()
    print(f"{name:12} {decibels:.2f} dB, mean level {levels:+.2f}")
    assert decibels >= LEAST_DB, f"{rendered}: {decibels:.2f} dB against {decoded}"
    assert abs(levels) <= MOST_LEVELS, f"{rendered}: {levels:+.2f} levels from {decoded}"


def check(facts: dict[str, Any], stream: Path, folder: Path) -> None:
    with open_stream(stream) as opened:
        last = opened.frame_count - 1
        states = {frame.index: frame.state for frame in opened.frames()}
        rate = opened.header.fps
    assert facts["range"] == [101, 101 + last, rate], facts["range"]
    assert facts["view"][0] == "Raw"
    assert facts["transparent"] == [False, True], "a subject is rendered over nothing, a whole scene is not"
    assert max(up[2] for up in facts["ups"]) >= LEAST_UP, facts["ups"]
    # The window of a module is no viewport: what is evaluated there is what renders have, or the viewport's fraction.
    assert 0 < facts["instances"] <= len(states[0]), facts["instances"]
    np.testing.assert_array_equal(np.load(folder / "ids.npy"), states[last].ids)
    assert facts["reopened"] == [len(states[0]), ""], facts["reopened"]
    damaged, missing, no_zstandard = facts["complaints"]
    for complaint in facts["complaints"]:
        assert complaint.startswith("Error: ")
        assert len(complaint.strip().splitlines()) == 1, complaint
    assert "half.dgs" in damaged
    assert "missing.dgs" in missing
    assert "zstandard" in no_zstandard
    assert 1 <= facts["damaged"] <= last, "what is left of a damaged stream is shown"
    assert facts["usd_rate"] == rate
    assert facts["usd_instances"] == [len(states[0]), len(states[last])], facts["usd_instances"]


def check_camera(stream: Path, folder: Path) -> None:
    """The scene's camera that the add-on wrote: cam00's pose and lens, the picture shifted up by 3 % of its width."""
    path = read_free_cameras(folder / "camera.json")
    with open_stream(stream) as opened:
        rig = next(camera for camera in opened.header.cameras if camera.name == "cam00")
        assert path.times == tuple(range(opened.frame_count)), path.times
    for camera in path.cameras:
        # Blender's matrices are float32; a point at 3 units and 200 pixels of focal length moves by .01 pixels.
        np.testing.assert_allclose(camera.world_to_camera, rig.world_to_camera, atol=1e-4)
        np.testing.assert_allclose((camera.fx, camera.fy, camera.cx), (rig.fx, rig.fy, rig.cx), atol=0.01)
        np.testing.assert_allclose(camera.near, max(rig.near, 1e-3), rtol=1e-5)
        np.testing.assert_allclose(camera.cy, rig.cy + 0.03 * rig.width, atol=0.01)


def check_turned(folder: Path) -> None:
    """A transform's scene is in Blender where the decoder has it: in float32, 10 units from the origin."""
    with open_stream(folder / "turned.dgs") as opened:
        expected = next(opened.frames()).splats.means
    points, instances = np.load(folder / "turned_points.npy"), np.load(folder / "turned_instances.npy")
    np.testing.assert_array_equal(points, expected)
    # The file's up is Y, Blender's Z; the order is the file's own.
    upright = expected[:, [0, 2, 1]] * np.float32([1, -1, 1])
    apart = np.linalg.norm(instances[:, None] - upright[None], axis=2)
    assert instances.shape == upright.shape
    assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-5
    print(f"transform    {len(points)} points, {apart.min(axis=0).max():.1e} units off by USD, none by the add-on")


def main(python: str, extension: str, folder: str) -> None:
    out = Path(folder).resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    stream, usd = out / "sample.dgs", out / "sample.usdc"
    encode(EncodeJob(RIG, stream, settings="live", frames=slice(0, FRAMES), scale=0.5))
    with_header(stream, out / "subject.dgs", subject=True)
    decode(stream, out / "decoded", view="cam00", undistorted=True, drift_free=True)
    export(stream, usd)
    turned = Transform(turns=(("X", 40.0), ("Z", 25.0)), scale=2.5, shift=(1.0, -2.0, 0.5))
    edit(stream, out / "turned.dgs", [Trim(slice(0, 1)), Crop(Sphere((0.0, 0.0, 0.0), 1.0)), turned])
    export(out / "turned.dgs", out / "turned.usdc", up="none")
    script = Path(__file__).with_name("in_blender.py")
    settings = out / "blender-settings"
    subprocess.run(
        [python, str(script), str(Path(extension).resolve()), str(stream), str(usd), str(out)],
        env=os.environ | {"BLENDER_USER_RESOURCES": str(settings)},
        check=True,
        stdout=(out / "blender.log").open("w"),
        stderr=subprocess.STDOUT,
    )
    facts = json.loads((out / "facts.json").read_text())
    print(f"Blender {facts['version']}, numpy {facts['numpy']}; seconds to change the frame {facts['seconds']}, ")
    print(f"to render {facts['render_seconds']}; instances in the viewport {facts['instances']}")
    check(facts, stream, out)
    decoded = sorted((out / "decoded").iterdir())
    check_camera(stream, out)
    check_turned(out)
    compare("first frame", out / "stream_0.png", decoded[0])
    compare("last frame", out / "stream_1.png", decoded[-1])
    compare("USD, first", out / "usd_0.png", decoded[0])
    compare("USD, last", out / "usd_1.png", decoded[-1])
    for complaint in facts["complaints"]:
        print(complaint.strip())


if __name__ == "__main__":
    main(*sys.argv[1:])

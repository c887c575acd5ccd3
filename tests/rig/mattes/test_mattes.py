"""Mattes of every source reach the frames that training takes; what cannot be one is refused by name."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest

from decogs.encoder import MatteChoice
from decogs.encoder.analyze_command import analyze_main
from decogs.encoder.commands import encode_main
from decogs.formats.errors import DecogsError, RigError, UsageError
from decogs.formats.rigs import open_rig
from decogs.rig.check.mattes import check_mattes
from decogs.rig.mattes import open_mattes
from decogs.rig.pictures.ingest import Ingest, RigFrame
from stages.make import coded, light_on_backdrop, look, render, write_stage
from stages.scenes import STAGES, cameras, stool

VIEWS = cameras((96, 128))[::2]
NAMES = [view.name for view in VIEWS]


@pytest.fixture(scope="module")
def green(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stage("green", tmp_path_factory.mktemp("mattes") / "green", VIEWS, frames=2)


@pytest.fixture
def masks(green: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(green / "truth/mattes", tmp_path / "masks"))


def opened(rig: Path, scale: float = 1.0, holdout: tuple[str, ...] = (), **choice: Any) -> Ingest:
    read = open_rig(rig)
    mattes = open_mattes(MatteChoice(**choice), read, range(read.frame_count), holdout)
    return Ingest(read, scale=scale, holdout=holdout, mattes=mattes)


def frame_of(ingest: Ingest, index: int = 0) -> RigFrame:
    return next(ingest.frames(index, index + 1))


def read(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert picture is not None, path
    return picture


def rewrite(path: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    assert cv2.imwrite(str(path), np.ascontiguousarray(change(read(path))))


def greenness(picture: np.ndarray) -> np.ndarray:
    return np.asarray(picture[1] - picture[[0, 2]].max(axis=0))


def check(rig: Path, masks: Path) -> list[str]:
    warnings: list[str] = []
    ingest = opened(rig, masks=masks)
    assert check_mattes(ingest, frame_of(ingest), warnings.append).startswith("mattes agree")
    return warnings


# --- files ----------------------------------------------------------------------------------------------------------


def test_masks_are_alpha_and_take_the_backdrop_out_of_outlines(green: Path, masks: Path) -> None:
    shutil.rmtree(masks / NAMES[1])
    ingest = opened(green, masks=masks, holdout=(NAMES[1], NAMES[2]))
    frame, plain = frame_of(ingest, 1), frame_of(opened(green, holdout=(NAMES[1], NAMES[2])), 1)
    for view, alpha in zip(ingest.views, frame.alpha, strict=True):
        np.testing.assert_array_equal(alpha, read(masks / view.camera.name / "0001.png") / np.float32(255))
    assert frame.held_out_alpha[0] is None
    assert frame.held_out_alpha[1] is not None
    for alpha, picture, raw in zip(frame.alpha, frame.training, plain.training, strict=True):
        np.testing.assert_array_equal(picture[:, alpha == 1], raw[:, alpha == 1])
        outline = (alpha > 0.3) & (alpha < 0.8)
        assert greenness(raw)[outline].mean() > 0.03
        assert greenness(picture)[outline].mean() < 0  # as of the subject: no cloth of it is green
    assert (plain.alpha, plain.plates) == ((), ()) or (list(plain.alpha), list(plain.plates)) == ([], [])
    assert check(green, green / "truth/mattes") == []


def counted_from_1(masks: Path) -> None:
    for file in sorted(masks.glob("*/*.png"), reverse=True):
        file.rename(file.with_name(f"{int(file.stem) + 1:04d}.png"))


def easyvolcap(masks: Path) -> None:
    for folder in sorted(masks.iterdir()):
        for file in sorted(folder.glob("*.png")):
            file.rename(file.with_name(f"{int(file.stem):06d}.png"))
        folder.rename(masks / folder.name[-2:])


def sixteen_bit(masks: Path) -> None:
    for file in masks.glob("*/*.png"):
        rewrite(file, lambda matte: matte.astype(np.uint16) * 257)


def cut_outs(masks: Path) -> None:
    for file in masks.glob("*/*.png"):
        rewrite(file, lambda matte: np.dstack([matte // 2, matte // 3, matte // 4, matte]))


def background_matting(masks: Path) -> None:
    for folder in list(masks.iterdir()):
        folder.rename(masks / "pha")
        folder.mkdir()
        (masks / "pha").rename(folder / "pha")


def webp(masks: Path) -> None:
    for file in list(masks.glob("*/*.png")):
        assert cv2.imwrite(str(file.with_suffix(".webp")), read(file), [cv2.IMWRITE_WEBP_QUALITY, 101])
        file.unlink()


def bmp(masks: Path) -> None:
    for file in list(masks.glob("*/*.png")):
        assert cv2.imwrite(str(file.with_suffix(".bmp")), read(file))
        file.unlink()


@pytest.mark.parametrize("layout", [counted_from_1, easyvolcap, sixteen_bit, cut_outs, background_matting, webp, bmp])
def test_layouts_of_other_tools_give_the_same(green: Path, masks: Path, layout: Callable[[Path], None]) -> None:
    expected = frame_of(opened(green, masks=masks), 1).alpha
    layout(masks)
    np.testing.assert_array_equal(frame_of(opened(green, masks=masks), 1).alpha, expected)


@pytest.mark.parametrize("name", [f"{NAMES[0]}.mp4", f"{NAMES[0]}/pha.mp4", f"{NAMES[0]}/matte.mp4"])
def test_a_video_of_mattes_is_read(green: Path, masks: Path, name: str) -> None:
    """Also as BackgroundMattingV2 writes it, with what it was made from, and its foreground, beside it."""
    expected = frame_of(opened(green, masks=masks), 1).alpha[0]
    mattes = [read(file) for file in sorted((masks / NAMES[0]).glob("*.png"))]
    shutil.rmtree(masks / NAMES[0])
    (masks / name).parent.mkdir(exist_ok=True)
    writer = cv2.VideoWriter(str(masks / name), cv2.VideoWriter_fourcc(*"mp4v"), 30, (96, 128))
    for matte in mattes:
        writer.write(matte[..., None].repeat(3, axis=2))
    writer.release()
    if name.endswith("pha.mp4"):
        (masks / name).with_name("fgr.mp4").write_bytes(b"0")
        cv2.imwrite(str((masks / name).with_name("bgr.png")), np.zeros((128, 96, 3), np.uint8))
    found = frame_of(opened(green, masks=masks), 1).alpha[0]
    assert np.abs(found - expected).mean() < 0.02  # a lossy codec at the outline


def test_mattes_of_fewer_frames_will_do_for_these(green: Path, masks: Path) -> None:
    for file in masks.glob("*/0001.png"):
        file.unlink()
    rig = open_rig(green)
    assert open_mattes(MatteChoice(masks=masks), rig, range(1)) is not None
    with pytest.raises(RigError, match=r"cam00: no matte of frame 1"):
        open_mattes(MatteChoice(masks=masks), rig, range(2))


def test_alpha_is_scaled_and_straightened_as_pictures_are(lens_rig: Path, tmp_path: Path) -> None:
    rig = open_rig(lens_rig)
    for camera in rig.cameras:  # a matte that shows what the picture's green does
        for file in sorted((lens_rig / camera.name).glob("*.png")):
            (tmp_path / camera.name).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / camera.name / file.name), read(file)[..., 1])
    pictures = frame_of(opened(lens_rig, scale=0.5)).training
    alphas = frame_of(opened(lens_rig, scale=0.5, masks=tmp_path)).alpha
    for picture, alpha in zip(pictures, alphas, strict=True):
        assert np.abs(picture[1] - alpha).max() < 1.6 / 255  # pictures are rounded to 8 bits twice, alpha is not


def test_other_mattes_are_another_recording(green: Path, masks: Path) -> None:
    before = frame_of(opened(green, masks=masks)).recorded
    rewrite(masks / NAMES[3] / "0000.png", lambda matte: 255 * (matte > 127).astype(np.uint8))
    after = frame_of(opened(green, masks=masks)).recorded
    assert [name for name in NAMES if before[name] != after[name]] == [NAMES[3]]
    keyed, with_other = (frame_of(opened(green, key=key)).recorded for key in ("green", "0,200,90"))
    plain = frame_of(opened(green)).recorded
    assert all(len({plain[name], keyed[name], with_other[name], before[name]}) == 4 for name in NAMES)


# --- pictures' own alpha --------------------------------------------------------------------------------------------


def with_alpha(green: Path, folder: Path) -> Path:
    shutil.copytree(green, folder)
    for name in NAMES:
        for file in (folder / name).glob("*.png"):
            matte = read(green / "truth/mattes" / name / file.name)
            rewrite(file, lambda picture, matte=matte: np.dstack([picture * (matte > 0)[..., None], matte]))
    return folder


def test_own_alpha_counts_and_colours_go_on_where_it_is_0(green: Path, tmp_path: Path) -> None:
    folder = with_alpha(green, tmp_path / "rig")
    frame, opaque = frame_of(opened(folder)), frame_of(opened(green))
    for name, alpha, picture, plain in zip(NAMES, frame.alpha, frame.training, opaque.training, strict=True):
        np.testing.assert_array_equal(alpha, read(green / f"truth/mattes/{name}/0000.png") / np.float32(255))
        np.testing.assert_array_equal(picture[:, alpha > 0], plain[:, alpha > 0])
        assert picture[:, alpha == 0].max() > 0.1, "black under alpha 0 would darken outlines"
    assert list(frame_of(opened(folder, own_masks=False)).alpha) == []
    for name in NAMES:
        for file in (folder / name).glob("*.png"):
            rewrite(file, lambda picture: np.dstack([picture[..., :3], np.full(picture.shape[:2], 255, np.uint8)]))
    assert list(frame_of(opened(folder)).alpha) == []


@pytest.mark.parametrize(
    ("opaque", "has_alpha", "seen"),
    [((0,), True, 3), ((0, 1), True, 3), ((0, 3), True, 1), ((0, 2, 3), True, 1), ((0,), False, 3)],
)
def test_a_take_of_cut_outs_that_begins_opaque_is_refused(
    moving_rig: Path, tmp_path: Path, opaque: tuple[int, ...], has_alpha: bool, seen: int
) -> None:
    """Such as with a slate: its cut-outs would be encoded with their backdrop. Behind it, they are what they are."""
    folder = Path(shutil.copytree(moving_rig, tmp_path / "rig"))
    for file in folder.glob("*/*.png"):
        if has_alpha or int(file.stem) not in opaque:
            alpha = np.full((48, 64), 255, np.uint8)
            alpha[:8] *= int(file.stem) in opaque
            rewrite(file, lambda picture, alpha=alpha: np.dstack([picture, alpha]))
    with pytest.raises(RigError, match=f"are opaque in frame 0 and cut-outs in frame {seen}; begin where all"):
        opened(folder)
    assert list(frame_of(opened(folder, own_masks=False)).alpha) == []
    rig = open_rig(folder)
    mattes = open_mattes(MatteChoice(), rig, range(1, 2) if 1 not in opaque else range(2, 4))
    assert mattes is not None
    assert mattes.is_own


def test_alpha_in_some_cameras_only_is_refused(green: Path, tmp_path: Path) -> None:
    folder = with_alpha(green, tmp_path / "rig")
    for file in (folder / NAMES[2]).glob("*.png"):
        rewrite(file, lambda picture: picture[..., :3])
    with pytest.raises(RigError, match=f"camera {NAMES[2]} have no alpha, those of {NAMES[0]} have"):
        opened(folder)
    assert len(frame_of(opened(folder, holdout=(NAMES[2],))).alpha) == len(NAMES) - 1


def test_premultiplied_exr_become_straight(green: Path, tmp_path: Path) -> None:
    calibration = json.loads((green / "rig.json").read_text())
    colours = np.full((128, 96, 3), (0.2, 0.4, 0.1), np.float32)
    alpha = np.zeros((128, 96), np.float32)
    alpha[30:90, 20:70], alpha[30:90, 70:74] = 1, 0.25
    for name in NAMES:
        (tmp_path / name).mkdir()
        channels = {"RGBA"[i]: colours[..., i] * alpha for i in range(3)} | {"A": alpha}
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, channels).write(str(tmp_path / name / "0000.exr"))
    (tmp_path / "rig.json").write_text(json.dumps(calibration))
    frame = frame_of(opened(tmp_path))
    np.testing.assert_allclose(frame.alpha[0], alpha, atol=1e-6)
    assert np.ptp(frame.training[0], axis=(1, 2)).max() < 1e-5, "one colour all over"  # float32


# --- what is ignored ------------------------------------------------------------------------------------------------


def test_ignored_pixels_do_not_teach(green: Path, tmp_path: Path) -> None:
    mask = np.full((128, 96), 255, np.uint8)
    mask[:20] = 0
    cv2.imwrite(str(tmp_path / f"{NAMES[1]}.png"), mask)
    ingest = opened(green, ignore=tmp_path)
    assert ingest.views[0].valid is None
    np.testing.assert_array_equal(ingest.views[1].valid, mask / 255)
    assert not ingest.has_mattes
    picture = frame_of(ingest).training[1]
    np.testing.assert_array_equal(picture[:, 0], picture[:, 19])


def test_a_mask_that_leaves_nothing_is_refused(green: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / f"{NAMES[1]}.png"), np.zeros((128, 96), np.uint8))
    with pytest.raises(RigError, match=f"{NAMES[1]}.png: black all over"):
        opened(green, ignore=tmp_path)
    (tmp_path / f"{NAMES[1]}.png").unlink()
    with pytest.raises(RigError, match="no mask of any camera"):
        opened(green, ignore=tmp_path)


def test_masks_that_a_calibration_names_are_ignore_masks(green: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(green, tmp_path / "rig"))
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [
        {"file_path": f"{view.name}/{frame:04d}.png", "mask_path": f"{view.name}-{frame}.png"}
        | {"transform_matrix": (np.linalg.inv(view.world_to_camera) @ flip).tolist(), "fl_x": view.fx}
        for view in VIEWS
        for frame in range(2)
    ]
    (folder / "rig.json").unlink()
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    mask = np.full((128, 96), 255, np.uint8)
    mask[:, :30] = 0
    for view in VIEWS:
        for frame in range(2):
            cv2.imwrite(str(folder / f"{view.name}-{frame}.png"), mask)
    np.testing.assert_array_equal(opened(folder).views[3].valid, mask / 255)
    assert opened(folder, own_masks=False).views[3].valid is None
    rewrite(folder / f"{NAMES[3]}-1.png", lambda mask: 255 - mask)
    with pytest.raises(RigError, match=f"2 masks of camera {NAMES[3]}; give one"):
        opened(folder)
    (folder / f"{NAMES[3]}-1.png").unlink()
    with pytest.raises(RigError, match=f"{NAMES[3]}-1.png"):
        opened(folder)


# --- keys and plates ------------------------------------------------------------------------------------------------


def iou(alpha: np.ndarray, matte: np.ndarray) -> float:
    one, other = alpha > 0.5, matte > 127
    return float((one & other).sum() / (one | other).sum())


def without_stool(alpha: np.ndarray, matte: np.ndarray) -> np.ndarray:
    """The alpha near the matte: the stool stands still and is not in the mattes."""
    return np.where(cv2.dilate(matte, np.ones((5, 5))) > 0, alpha, 0)


def test_a_key_finds_the_subject_and_takes_the_spill_off(green: Path) -> None:
    frame = frame_of(opened(green, key="green"))
    for name, alpha, picture in zip(NAMES, frame.alpha, frame.training, strict=True):
        matte = read(green / f"truth/mattes/{name}/0000.png")
        # A tenth of a pixel along the outlines of two performers, who are 10 pixels wide, is .02; measured: .86 to .93.
        assert iou(without_stool(alpha, matte), matte) > 0.84, name
        edge = (alpha > 0.2) & (alpha < 0.9)
        assert greenness(picture)[edge].mean() < 0.03, f"{name}: a green rim"


@pytest.mark.parametrize("name", ["cam00.heic", "cam00/plate.heic"])
@pytest.mark.parametrize("choice", ["background_plate", "ignore"])
def test_a_picture_of_an_unknown_ending_is_not_called_missing(
    green: Path, tmp_path: Path, choice: str, name: str
) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_bytes(b"0")
    with pytest.raises(RigError, match=rf"{name}: files ending in \.heic are not read"):
        opened(green, **{choice: tmp_path})


def test_a_clean_plate_tells_the_subject_from_its_shadow(green: Path, tmp_path: Path) -> None:
    stage, backdrop = STAGES["green"], light_on_backdrop(STAGES["green"], stool(), 128)
    for index, view in enumerate(VIEWS):
        linear, _ = render(look(view, stage), stool(), backdrop)
        cv2.imwrite(str(tmp_path / f"{view.name}.png"), coded(linear, np.random.default_rng(index))[..., ::-1])
    ingest = opened(green, background_plate=tmp_path)
    frame = frame_of(ingest)
    for name, alpha, plate in zip(NAMES, frame.alpha, frame.plates, strict=True):
        matte = read(green / f"truth/mattes/{name}/0000.png")
        assert iou(alpha, matte) > 0.88, name
        np.testing.assert_array_equal(
            np.rint(255 * plate.transpose(1, 2, 0)), read(tmp_path / f"{name}.png")[..., ::-1]
        )
    frame = frame_of(opened(green, background_plate=tmp_path, masks=green / "truth/mattes"))
    np.testing.assert_array_equal(255 * frame.alpha[0], read(green / f"truth/mattes/{NAMES[0]}/0000.png"))
    cv2.imwrite(str(tmp_path / f"{NAMES[4]}.png"), np.full((128, 96, 3), 200, np.uint8))
    with pytest.raises(RigError, match=f"camera {NAMES[4]}: most of its picture differs from its clean one"):
        frame_of(opened(green, background_plate=tmp_path))
    (tmp_path / f"{NAMES[4]}.png").unlink()
    with pytest.raises(RigError, match=f"no clean picture of camera {NAMES[4]}"):
        opened(green, background_plate=tmp_path)


@pytest.mark.parametrize("key", ["pink", "1,2", 5, "300,0,0", "1,2,3,4", "0,0,0", "90,90,100"])
def test_a_key_that_is_no_screen_s_colour_is_refused(green: Path, key: Any) -> None:
    with pytest.raises(UsageError, match=f"`key` {key}"):
        opened(green, key=key)


def test_a_key_of_another_colour_finds_no_screen(green: Path) -> None:
    with pytest.raises(RigError, match="shows no screen of the colour of `key`"):
        frame_of(opened(green, key="blue"))


# --- what cannot be ------------------------------------------------------------------------------------------------


def swapped(masks: Path) -> None:
    (masks / NAMES[1]).rename(masks / "other")
    (masks / NAMES[2]).rename(masks / NAMES[1])
    (masks / "other").rename(masks / NAMES[2])


def unread_pictures(masks: Path) -> None:
    for file in list((masks / NAMES[1]).iterdir()):
        file.rename(file.with_suffix(".heic"))


def unread_video(masks: Path) -> None:
    shutil.rmtree(masks / NAMES[1])
    (masks / f"{NAMES[1]}.wmv").write_bytes(b"0")


def two_videos(masks: Path) -> None:
    shutil.rmtree(masks / NAMES[1])
    (masks / NAMES[1]).mkdir()
    for name in ("com.mp4", "fgr.mp4"):
        (masks / NAMES[1] / name).write_bytes(b"0")


def changed(change: Callable[[np.ndarray], np.ndarray], name: str = NAMES[2]) -> Callable[[Path], None]:
    def apply(masks: Path) -> None:
        for file in masks.glob(f"{name}/0000.png"):
            rewrite(file, change)

    return apply


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda masks: shutil.rmtree(masks / NAMES[3]), f"no mattes of camera {NAMES[3]}"),
        (lambda masks: (masks / NAMES[3] / "0001.png").unlink(), f"{NAMES[3]}: no matte of frame 1"),
        (lambda masks: shutil.copytree(masks / NAMES[3], masks / NAMES[3][-2:]), f"is of camera {NAMES[3]}, too"),
        (changed(lambda matte: matte[::2, ::2]), f"{NAMES[2]}/0000.png: 48 x 64 pixels"),
        (changed(lambda matte: np.full_like(matte, 255)), f"{NAMES[2]}/0000.png: white all over"),
        (changed(lambda matte: 255 - matte), f"{NAMES[2]}/0000.png: white at all borders"),
        (changed(lambda matte: 0 * matte), f"{NAMES[2]}/0000.png: leaves out (9[0-9]|100)%"),
        (changed(lambda matte: 0 * matte, "*"), "black all over"),
        (changed(lambda matte: matte // 128), f"{NAMES[2]}/0000.png: nowhere brighter than 1 of 255"),
        (
            changed(lambda matte: np.dstack([0 * matte, 0 * matte, matte])),
            f"{NAMES[2]}/0000.png: is a picture in colour",
        ),
        (unread_pictures, rf"{NAMES[1]}/0000.heic: files ending in .heic are not read"),
        (unread_video, rf"{NAMES[1]}.wmv: files ending in .wmv are not read"),
        (two_videos, rf"{NAMES[1]}: videos, of which none is called pha.mp4 \(com.mp4, fgr.mp4\)"),
        (swapped, f"({NAMES[1]}|{NAMES[2]})/0000.png: the other cameras' mattes confirm only"),
    ],
)
def test_what_cannot_be_a_matte_is_named(green: Path, masks: Path, damage: Callable[[Path], None], said: str) -> None:
    damage(masks)
    with pytest.raises(DecogsError, match=said) as caught:
        check(green, masks)
    assert "\n" not in str(caught.value)


def test_a_hand_that_one_matte_lacks_is_a_warning(green: Path, masks: Path) -> None:
    def cut(matte: np.ndarray) -> np.ndarray:
        rows = np.flatnonzero(matte.any(axis=1))
        matte[: rows[0] + len(rows) // 4] = 0
        return matte

    changed(cut)(masks)
    (warning,) = check(green, masks)
    assert f"{NAMES[2]}/0000.png: mattes contradict each other" in warning


def test_an_analysis_refuses_mattes_that_do_not_agree(
    green: Path, masks: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(masks / NAMES[0])
    (masks / NAMES[1]).rename(masks / NAMES[0])
    assert analyze_main([str(green), "--masks", str(masks), "-q"]) == 2
    assert "mattes agree" not in "".join(capsys.readouterr())


@pytest.mark.slow
def test_an_analysis_says_that_mattes_agree_and_names_those_of_later_frames_that_are_lost(
    green: Path, masks: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only the first frame's mattes are compared with each other, before all else; those of all frames are read."""
    agree = "mattes agree: of a camera's subject the others confirm 100% at least\n"
    assert analyze_main([str(green), "--masks", str(masks), "-q"]) == 0
    assert (said := capsys.readouterr()).out.startswith(agree)
    assert "matte in" not in said.err
    last = sorted((masks / NAMES[1]).iterdir())[-1]
    last.write_bytes(last.read_bytes()[:40])
    white = sorted((masks / NAMES[0]).iterdir())[-1]
    assert cv2.imwrite(str(white), np.full_like(cv2.imread(str(white), 0), 255))
    assert analyze_main([str(green), "--masks", str(masks), "-q", "--json", "-"]) == 0
    first, *others = capsys.readouterr().err.splitlines(keepends=True)
    assert first == agree
    lost = [line for line in others if "no matte in" in line]
    frame = int(last.stem)
    assert len(lost) == 2
    assert f"camera {NAMES[1]} has no matte in frame {frame}, and is left out there: {last}: " in "".join(lost)
    assert f"camera {NAMES[0]} has no matte in frame {frame}, and is left out there: it is white all over" in "".join(
        lost
    )


def test_two_cameras_cannot_say_whether_mattes_agree(green: Path, masks: Path) -> None:
    ingest = opened(green, masks=masks, holdout=tuple(NAMES[2:]))
    assert check_mattes(ingest, frame_of(ingest), lambda text: None).endswith("whether they agree only 3 cameras say")


def test_the_command_names_its_options(green: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [str(green), "-o", str(tmp_path / "x.dgs"), "-q"]
    assert encode_main([*arguments, "--masks", str(green / "truth/mattes"), "--key", "green"]) == 2
    assert "--key: it does not go with --masks" in capsys.readouterr().err
    assert encode_main([*arguments, "--key", "blue"]) == 2
    assert "no screen of the colour of --key; check it, or use --masks" in capsys.readouterr().err
    written = green / "truth/mattes" / NAMES[0] / "0000.png"
    assert encode_main([*arguments[:2], str(written), "-q", "--masks", str(green / "truth/mattes")]) == 2
    assert "is a matte or a plate of the rig" in capsys.readouterr().err

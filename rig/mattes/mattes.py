"""The mattes of a rig's training pictures, whatever they come from."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from decogs.formats.colours.srgb import linear_from_srgb, srgb_from_linear
from decogs.formats.errors import RigError
from decogs.formats.mattes import alpha_of, matte_origin, matte_rig, own_alpha_rig, pictures_per_camera
from decogs.formats.pictures.reading import Picture, read_picture
from decogs.formats.rigs import OnLost, Rig, read_frames
from decogs.formats.rigs.sources import files_of_source, list_folder, refuse_unknown_kinds
from decogs.formats.splats import FloatArray

from .choice import MatteChoice
from .chroma_key import key_axis, keyed
from .chroma_siting import centred_chroma
from .clean_plate import before_plate
from .cutting import BoolArray, Subject, with_alpha
from .filling import push_pull

_LINEAR = linear_from_srgb(np.arange(256) / 255).astype(np.float32)
"""Of each 8-bit level."""
_MIN_KEPT_ALPHA = 0.5
"""Of an ignore mask, from which a pixel teaches."""


@dataclass(frozen=True)
class Cut:
    """A camera's picture with the subject's own colours, and alpha (H, W) 0..1; None where the camera has no matte.

    ``screen_coloured_share``: the share of a keyed subject that has the screen's colour.
    """

    picture: Picture
    alpha: FloatArray | None
    screen_coloured_share: float = 0.0


@dataclass(frozen=True)
class Mattes:
    """Ready to cut pictures: a rig whose "pictures" are mattes, or a key, or plates.

    ``is_own``: the mattes are the pictures' own alpha. ``plates``: clean pictures by camera; ``kept``: by camera, the
    pixels (H, W) that teach. ``files``: all that is read.
    """

    rig: Rig | None = None
    is_own: bool = False
    key: FloatArray | None = None
    plates: Mapping[str, Picture] = field(default_factory=dict)
    kept: Mapping[str, BoolArray] = field(default_factory=dict)
    files: tuple[Path, ...] = ()

    @property
    def cuts(self) -> bool:
        """Whether there are mattes, not only pixels that teach nothing."""
        return self.rig is not None or self.key is not None or bool(self.plates)

    def origin(self, name: str, frame: int) -> str:
        """Where the matte of a camera and frame comes from, for a message."""
        if self.rig is None or name not in [camera.name for camera in self.rig.cameras]:
            return f"the matte of camera {name}, frame {frame}"
        return matte_origin(self.rig, name, frame)

    def given(
        self, names: Collection[str], start: int, stop: int, on_lost: OnLost | None = None, *, step: int = 1
    ) -> Iterator[Mapping[str, FloatArray]]:
        """The mattes (H, W) that files have, by camera, of each frame; ``on_lost`` as of `read_frames`."""
        if self.rig is None:
            yield from ({} for _ in range(start, stop, step))
            return
        having = [camera.name for camera in self.rig.cameras if camera.name in names]
        for _, mattes in read_frames(self.rig, start, stop, step=step, names=having, on_lost=on_lost):
            yield {name: alpha_of(matte) for name, matte in zip(having, mattes, strict=True)}

    def digest_inputs(self, name: str, given: FloatArray | None) -> Iterator[Picture]:
        """Whatever makes a cut picture another one, as arrays."""
        if given is not None:
            yield given
        if self.key is not None:
            yield np.rint(1000 * self.key)
        if name in self.plates:
            yield self.plates[name]
        if name in self.kept:
            yield self.kept[name].astype(np.uint8)

    def cut(self, name: str, picture: Picture, given: FloatArray | None) -> Cut:
        """A camera's picture and its alpha. Raises RigError where it shows no screen, or not what its plate does."""
        if given is not None:
            return Cut(self._own_colours(name, picture, given), given)
        if self.key is not None:
            key = keyed(linear(centred_chroma(picture)), self.key)
            if key is None:
                raise RigError(f"camera {name} shows no screen of the colour of `key`; check it, or use `masks`")
            return Cut(_like(picture, key.subject), key.subject.alpha, key.screen_coloured_share)
        if self.rig is None and name in self.plates:
            subject = before_plate(linear(picture), linear(self.plates[name]))
            if subject is None:
                raise RigError(
                    f"camera {name}: most of its picture differs from its clean one in `background_plate`; take that "
                    "with the same camera, exposure and light, or use `masks`"
                )
            return Cut(picture, subject.alpha)
        return Cut(picture, None)

    def _own_colours(self, name: str, picture: Picture, alpha: FloatArray) -> Picture:
        """The picture without what was behind its outlines, unless a plate tells that to whoever composites it."""
        if self.is_own:
            return _straight(picture, alpha)
        return picture if name in self.plates else _like(picture, with_alpha(linear(picture), alpha))


def open_mattes(choice: MatteChoice | None, rig: Rig, frames: range, held_out: Collection[str] = ()) -> Mattes | None:
    """The mattes of a rig as they are asked for, for these ``frames``; None where there are none.

    Cameras ``held_out`` need none. Raises RigError and UsageError, naming the file.
    """
    choice = MatteChoice() if choice is None else choice
    names = [camera.name for camera in rig.cameras if camera.name not in held_out]
    ignored = _ignore_masks(choice, rig)
    kept = {name: _kept(rig, name, file) for name, file in ignored.items()}
    plates = _plates(choice, rig, names)
    given, is_own = None, False
    if choice.masks is not None:
        given = matte_rig(Path(choice.masks), rig, names, frames)
    elif choice.own_masks and choice.key is None and not plates:
        given = own_alpha_rig(rig, names, frames)
        is_own = given is not None
    key = None if choice.key is None else key_axis(choice.key)
    pictures = {name: _at_size(rig, name, file) for name, file in plates.items()}
    mattes = Mattes(given, is_own, key, pictures, kept, tuple(_files(given, ignored, plates)))
    return mattes if mattes.cuts or kept else None


def files_of_mattes(mattes: Mattes | None) -> list[tuple[Path, str]]:
    """Every file that is read for them, and what it is called."""
    return [] if mattes is None else [(file, "is a matte or a plate of the rig") for file in mattes.files]


def _files(given: Rig | None, *by_camera: Mapping[str, Path]) -> Iterator[Path]:
    for source in () if given is None else given.sources:
        yield from files_of_source(source)
    for files in by_camera:
        yield from files.values()


def _ignore_masks(choice: MatteChoice, rig: Rig) -> dict[str, Path]:
    """The mask of each camera that has one."""
    named = dict(rig.ignore_masks) if choice.own_masks else {}
    for name, files in named.items():
        if len({_content(file) for file in files}) > 1:
            raise RigError(
                f"{files[0]}: the calibration names {len(files)} masks of camera {name}; give one for all its frames, "
                "or do without (`own_masks`)"
            )
    masks = {name: files[0] for name, files in named.items()}
    if choice.ignore is not None:
        given = pictures_per_camera(Path(choice.ignore), [camera.name for camera in rig.cameras])
        if not given:
            refuse_unknown_kinds(list_folder(Path(choice.ignore)))
            raise RigError(f"{choice.ignore}: no mask of any camera; name them after the cameras, like cam00.png")
        masks |= given
    return masks


def _kept(rig: Rig, name: str, file: Path) -> BoolArray:
    kept = alpha_of(_at_size(rig, name, file)) >= _MIN_KEPT_ALPHA
    if not kept.any():
        raise RigError(f"{file}: black all over, so that camera {name} teaches nothing; white is what counts")
    return np.asarray(kept)


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise RigError(
            f"{file}: cannot be read ({error.strerror}); put the mask back, or do without (`own_masks`)"
        ) from None


def _plates(choice: MatteChoice, rig: Rig, names: list[str]) -> dict[str, Path]:
    if choice.background_plate is None:
        return {}
    plates = pictures_per_camera(Path(choice.background_plate), [camera.name for camera in rig.cameras], names)
    for name in names:
        if name not in plates:
            raise RigError(f"{choice.background_plate}: no clean picture of camera {name}; add {name}.png")
    return plates


def _at_size(rig: Rig, name: str, file: Path) -> Picture:
    """The picture in a file, which must have its camera's size."""
    camera = next(camera for camera in rig.cameras if camera.name == name)
    picture = read_picture(file)
    if picture.shape[1::-1] != (camera.width, camera.height):
        raise RigError(
            f"{file}: {picture.shape[1]} x {picture.shape[0]} pixels, but the pictures of camera {name} have "
            f"{camera.width} x {camera.height}; bring both to one size"
        )
    return picture


def linear(picture: Picture) -> FloatArray:
    """A picture (H, W, 3) in linear light."""
    return _LINEAR[picture] if picture.dtype == np.uint8 else np.asarray(picture, np.float32)


def _like(picture: Picture, subject: Subject) -> Picture:
    """The subject's colours as the picture has its own: linear floats, or coded bytes."""
    if picture.dtype != np.uint8:
        return subject.colours
    coded = srgb_from_linear(np.clip(subject.colours, 0, 1))
    return np.rint(255 * coded).astype(np.uint8)


def _straight(picture: Picture, alpha: FloatArray) -> Picture:
    """The colours that alpha belongs to: EXR are premultiplied; where nothing is, those around go on."""
    part = alpha[..., None]
    colours = picture / np.maximum(part, 1 / 255) if picture.dtype != np.uint8 else picture.astype(np.float32)
    filled = push_pull(np.asarray(colours, np.float32), alpha)
    straight = np.where(part > 0, colours, filled)
    return np.rint(straight).astype(np.uint8) if picture.dtype == np.uint8 else np.asarray(straight, np.float32)

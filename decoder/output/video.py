"""Videos through FFmpeg (PyAV): H.264 and HEVC, ProRes, with sound.

==========  ===========================  =========================================================
name        codec, the default first     pixels
==========  ===========================  =========================================================
``x.mp4``   h264, hevc                   8 bit, 4:2:0; browsers play h264
``x.mov``   prores, hevc, h264           ProRes 4444, 10 bit; HEVC 10 bit
==========  ===========================  =========================================================

Colours are BT.709, limited range, and tagged so. 4:2:0 has a quarter of the colour samples, and what a picture loses by
them depends on how a player fills them up again. Ours are those from which interpolation about their centres, as
browsers do it on a GPU, gives the least error, and the file is tagged so. Of ``workbench`` (352x264) Chromium then
shows 45.2 dB; with the means of four pixels, 41.6. Players that repeat colour samples instead, such as FFmpeg by
default, show 37.0 instead of 39.4: no 4:2:0 gives them 42. ``chroma`` "444" keeps all samples; Chromium plays it,
others may not. ProRes takes pictures of four channels, too: straight colours and alpha, which has its full range.

Licences: PyAV is BSD-3-Clause. Its wheels hold FFmpeg (LGPL-3.0) and x264 and x265 (GPL-2.0-or-later), which make these
videos; nothing of it comes with decogs. Who passes on a bundle with that wheel passes on GPL software. Patents on
H.264, HEVC and AAC are another matter again, where they hold.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from decogs.formats.errors import UsageError
from decogs.formats.frames.rates import exact_rate
from decogs.formats.splats import FloatArray

Codec = Literal["h264", "hevc", "prores"]
Chroma = Literal["420", "444"]

CODECS: dict[str, tuple[Codec, ...]] = {".mp4": ("h264", "hevc"), ".mov": ("prores", "hevc", "h264")}
"""What each kind of file may hold, its default first."""

DEFAULT_CRF = 2.0
"""Constant rate factor at which a browser shows ``workbench`` with 45 dB against the PNGs; lossless 4:2:0 has 45.6."""

_CHROMA = [2 / 3 * (-1 / 3) ** k for k in range(6)]
_CHROMA = [weight / (2 * sum(_CHROMA)) for weight in _CHROMA]
"""Of the samples on either side, from the nearest on, each the one after next."""

_ENCODERS: dict[Codec, tuple[str, ...]] = {
    "h264": ("libx264", "libopenh264"),
    "hevc": ("libx265",),
    "prores": ("prores_ks",),
}
_THREADS = 4
"""Whatever the machine has: x264's and x265's bytes depend on it."""
_WITH_ALPHA = "yuva444p10le"
_BT709 = 1
_LIMITED = 1
_RED, _GREEN, _BLUE = 0.2126, 0.7152, 0.0722
"""Luma of BT.709."""
_SAMPLE_RATE = 48_000
_SOUND_BITS = 256_000
_BLOCK = 1024


@dataclass(frozen=True)
class VideoSettings:
    """How a video is encoded; None: by the file's kind.

    ``audio``: a file that is heard instead of the stream's own sound; ``silent``: neither is.
    """

    codec: Codec | None = None
    crf: float | None = None
    chroma: Chroma | None = None
    audio: Path | None = None
    silent: bool = False

    @property
    def is_plain(self) -> bool:
        """Whether nothing was asked for that only FFmpeg can do."""
        return (
            self.codec is None and self.crf is None and self.chroma is None and self.audio is None and not self.silent
        )


def check_settings(suffix: str, settings: VideoSettings) -> None:
    """Raises UsageError for what a file of this suffix cannot be; any but .mp4 and .mov is no video of FFmpeg's."""
    if suffix not in CODECS:
        if not settings.is_plain:
            raise UsageError(
                "`codec`, `crf`, `chroma`, `audio` and `silent` are for videos; name the output .mp4 or .mov"
            )
        return
    if settings.codec is not None and settings.codec not in CODECS[suffix]:
        raise UsageError(f"`codec` {settings.codec}: a {suffix} file holds {' or '.join(CODECS[suffix])}")
    codec = settings.codec or CODECS[suffix][0]
    if settings.crf is not None and (codec == "prores" or not 0 <= settings.crf <= 51):
        raise UsageError(
            f"`crf` {settings.crf:g}: " + ("ProRes has none" if codec == "prores" else "give 0 (best) to 51 (smallest)")
        )
    if settings.chroma == "420" and codec == "prores":
        raise UsageError("`chroma` 420: ProRes is written as 4444; leave it out, or choose another `codec`")


class Movie:
    """A video file that takes pictures in order, and the stereo samples (2, N) at 48 kHz that ``sound`` gives."""

    def __init__(
        self, path: Path, fps: float, settings: VideoSettings, sound: Iterator[FloatArray] | None = None
    ) -> None:
        import av

        self._path, self._settings, self._samples = path, settings, sound
        self._rate = exact_rate(fps)
        self.codec: Codec = settings.codec or CODECS[path.suffix.lower()][0]
        self._stream: Any = None
        self._sound: _Sound | None = None
        self._pictures = 0
        with _explained(path):
            self._container = av.open(str(path), "w", format=path.suffix[1:].lower(), options=_faststart(path))

    def write(self, picture: NDArray[np.uint8]) -> None:
        """Adds a display-referred picture (H, W, 3), for ProRes also (H, W, 4) with alpha; all have one shape."""
        if self._stream is None:
            self._begin(*picture.shape)
        with _explained(self._path):
            frame = _frame(picture, self._stream.pix_fmt)
            frame.pts, frame.time_base = self._pictures, 1 / self._rate
            self._container.mux(self._stream.encode(frame))
        self._pictures += 1
        if self._sound is not None:
            self._sound.until(self._pictures / self._rate)

    def finish(self) -> None:
        """Writes what the encoders hold back, and closes the file."""
        if self._stream is None:
            raise UsageError(f"{self._path.name}: a video needs at least one frame")
        with _explained(self._path):
            self._container.mux(self._stream.encode(None))
            if self._sound is not None:
                self._sound.finish(self._pictures / self._rate)
            self._container.close()

    def _begin(self, height: int, width: int, channels: int) -> None:
        with _explained(self._path):
            stream = self._container.add_stream(_encoder(self.codec, self._path), rate=self._rate)
        stream.pix_fmt = _WITH_ALPHA if channels == 4 else self._pixels()
        # 4:2:0 needs even sizes: an odd picture repeats its last row or column.
        stream.width, stream.height = width, height
        context = stream.codec_context
        context.color_range, context.colorspace, context.color_primaries, context.color_trc = (
            _LIMITED, _BT709, _BT709, _BT709,
        )  # fmt: skip
        context.thread_count = _THREADS
        context.time_base = 1 / self._rate
        stream.options = self._options(stream.codec_context.name, width * height * float(self._rate))
        self._stream = stream
        if self._samples is not None:
            with _explained(self._path):
                self._sound = _Sound(self._samples, self._container, self._path)

    def _pixels(self) -> str:
        if self.codec == "prores":
            return "yuv444p10le"
        full = self._settings.chroma == "444"
        return ("yuv444p" if full else "yuv420p") + ("10le" if self.codec == "hevc" else "")

    def _options(self, encoder: str, pixels_per_second: float) -> dict[str, str]:
        crf = DEFAULT_CRF if self._settings.crf is None else self._settings.crf
        # Where chroma lies: 1 is in the middle of four pixels, and only 4:2:0 has a place to say so.
        location = ":chromaloc=1" if "420" in self._pixels() else ""
        if encoder == "libx265":
            return {
                "crf": f"{crf:g}",
                "tag": "hvc1",
                "x265-params": f"log-level=none:pools={_THREADS}:frame-threads=2{location}",
            }
        if encoder == "libx264":
            # Its weighing of macroblocks reads memory that nobody has set: files of the same pictures had other bytes.
            return {"crf": f"{crf:g}", "preset": "medium", "x264-params": f"mbtree=0{location}"}
        if encoder == "libopenh264":  # has no constant quality: bits for each pixel, as x264 takes them at this factor
            return {"b": str(int(pixels_per_second * 8 * 2 ** (-crf / 6)))}
        return {"profile": "4444", "vendor": "apl0"}


def _frame(picture: NDArray[np.uint8], pixels: str) -> Any:
    """A picture (H, W, 3 or 4) as FFmpeg's frame: yuv420p, of even H and W, or yuv444p, either in 10 bit, yuva444p10le.

    FFmpeg's own conversion rounds on the way, which costs 1.5 dB of the 51 that ``panoptic_basketball`` has.
    """
    import av

    frame = av.VideoFrame(picture.shape[1], picture.shape[0], pixels)
    kind, unit = (np.dtype("<u2"), 4) if pixels.endswith("10le") else (np.dtype("u1"), 1)
    of_planes = [*planes(picture, reduced="420" in pixels)]
    if pixels == _WITH_ALPHA:  # in full range
        of_planes.append(picture[..., 3] * np.float32(1023 / 255 / unit))
    for plane, samples in zip(frame.planes, of_planes, strict=True):
        rows = np.zeros((plane.height, plane.line_size // kind.itemsize), kind)
        rows[:, : plane.width] = np.rint(samples * np.float32(unit))
        plane.update(rows)
    frame.color_range, frame.colorspace = _LIMITED, _BT709
    return frame


def planes(picture: NDArray[np.uint8], *, reduced: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Y, Cb and Cr of BT.709 in limited range (16 to 235, 16 to 240), not rounded; ``reduced``: a quarter of Cb, Cr."""
    red, green, blue = (picture[..., channel].astype(np.float32) for channel in range(3))
    # One product after the other: a matrix product may differ in its last bits from machine to machine.
    luma = np.float32(_RED) * red + np.float32(_GREEN) * green + np.float32(_BLUE) * blue
    chroma = [
        np.float32(224 / 255 / 2 / (1 - weight)) * (colour - luma) for weight, colour in ((_BLUE, blue), (_RED, red))
    ]
    if reduced:
        chroma = [halved(samples) for samples in chroma]
    first, second = (np.clip(samples + np.float32(128), 16, 240) for samples in chroma)
    return luma * np.float32(219 / 255) + np.float32(16), first, second


def halved(samples: FloatArray) -> FloatArray:
    """Half as many samples along both axes (of even lengths), in the middle between the old ones.

    Those from which linear interpolation gives back the old ones with the least square error: the pseudoinverse of
    interpolating, which is 2/3 sum over k of (-1/3)^k (s[2i - 2k] + s[2i + 1 + 2k]), cut off where it is a thousandth.
    """
    return np.asarray(_halved_columns(_halved_columns(samples).T).T)


def _halved_columns(values: FloatArray) -> FloatArray:
    count, reach = values.shape[1] // 2, len(_CHROMA)
    before = np.pad(values[:, ::2], ((0, 0), (reach, 0)), mode="edge")
    after = np.pad(values[:, 1::2], ((0, 0), (0, reach)), mode="edge")
    sums: FloatArray = np.zeros((values.shape[0], count), np.float32)
    for k, weight in enumerate(_CHROMA):
        first = reach - k
        sums += np.float32(weight) * (before[:, first : first + count] + after[:, k : k + count])
    return sums


class _Sound:
    """Stereo ``samples`` as AAC, in step with the pictures; ``samples`` may have more to give when asked again."""

    def __init__(self, samples: Iterator[FloatArray], container: Any, path: Path) -> None:
        self._samples, self._container, self._path, self._written = samples, container, path, 0
        self._output = container.add_stream("aac", rate=_SAMPLE_RATE, layout="stereo")
        self._output.bit_rate = _SOUND_BITS
        self._waiting = np.zeros((2, 0), np.float32)

    def until(self, seconds: Fraction) -> None:
        """Writes what is heard up to there, as far as it has come."""
        end = round(seconds * _SAMPLE_RATE)
        while self._written < end:
            wanted = min(_BLOCK, end - self._written)
            while self._waiting.shape[1] < wanted:
                block = next(self._samples, None)
                if block is None:
                    break
                self._waiting = np.concatenate([self._waiting, block], axis=1)
            taken, self._waiting = self._waiting[:, :wanted], self._waiting[:, wanted:]
            if not taken.shape[1]:
                return
            self._encode(taken)

    def finish(self, seconds: Fraction) -> None:
        """Writes the rest of it, and what the encoder holds back."""
        self.until(seconds)
        with _explained(self._path):
            self._container.mux(self._output.encode(None))

    def _encode(self, samples: NDArray[np.float32]) -> None:
        import av

        frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(samples), format="fltp", layout="stereo")
        frame.sample_rate, frame.pts, frame.time_base = _SAMPLE_RATE, self._written, Fraction(1, _SAMPLE_RATE)
        with _explained(self._path):
            self._container.mux(self._output.encode(frame))
        self._written += samples.shape[1]


class _explained:
    """What FFmpeg says of a file that it writes, as one line of ours."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        """Nothing to prepare."""

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        import av

        if isinstance(error, (av.FFmpegError, ValueError)) and not isinstance(error, UsageError):
            reason = getattr(error, "strerror", None) or str(error)
            raise UsageError(f"{self._path.name}: cannot be written ({reason}); choose another file") from None


def _encoder(codec: Codec, path: Path) -> str:
    import av

    for name in _ENCODERS[codec]:
        if name in av.codecs_available and _encodes(name):
            return name
    raise UsageError(f"{path.name}: this FFmpeg has no encoder for {codec}; choose another `codec`, or write PNG")


def _encodes(name: str) -> bool:
    import av

    try:
        av.Codec(name, "w")
    except ValueError:
        return False
    return True


def _faststart(path: Path) -> dict[str, str]:
    """What is needed to play comes first in the file, so that browsers can begin; the same bytes on every machine."""
    return {"movflags": "+faststart", "fflags": "+bitexact"} if os.fspath(path) else {}

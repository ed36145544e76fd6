"""What plain cameras would have filmed: videos with lenses, offsets and sound, and no calibration.

They are made of the capture that swings-synth makes; truth.json beside them has what is true.
"""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import av
import numpy as np
from scipy.ndimage import map_coordinates

from codec.arrays import Doubles
from codec.camera import Camera
from codec.files import making_folder
from codec.stream.sound import SAMPLE_RATE
from trainer.capture.capture import Capture, Picture
from trainer.capture.layout import open_capture
from trainer.capture.lens import Lens

from .film import SynthConfig, VideoWriter, synthesise

TRUTH_NAME = "truth.json"

MAX_OFFSET_S = 2.0
"""Cameras begin up to so much earlier than the last one."""

ZOOM = 1.12
"""Focal length over that of the capture: the corners of a lens that bends inwards need pixels from
further out."""

CLAPS_S = (0.4, 1.3)
"""Times of the first two claps after the last camera has begun; more follow, irregularly."""

SOUND_M_PER_S = 343.0


@dataclass(frozen=True, slots=True)
class PlainCamera:
    """A camera as it films."""

    camera: Camera
    lens: Lens
    first_frame: int
    """The frame of the capture at which it begins."""


def plain_cameras(capture: Capture, seed: int) -> list[PlainCamera]:
    """Cameras of one make: lenses differ a little, offsets up to MAX_OFFSET_S."""
    rng = np.random.default_rng([seed, 1])
    found = []
    for camera in (entry.camera for entry in capture.cameras):
        zoom = ZOOM * (1 + 0.01 * rng.uniform(-1, 1))
        shift = 0.01 * camera.width_px * rng.uniform(-1, 1, 2)
        bent = replace(
            camera,
            fx_px=camera.fx_px * zoom, fy_px=camera.fy_px * zoom,
            cx_px=camera.cx_px + shift[0], cy_px=camera.cy_px + shift[1],
        )  # fmt: skip
        first = int(rng.integers(0, round(MAX_OFFSET_S * (capture.fps or 30)) + 1))
        lens = Lens(k1=-0.06 + 0.01 * rng.uniform(-1, 1))
        found.append(PlainCamera(bent, lens, first))
    return found


def synthesise_plain(config: SynthConfig) -> None:
    """Writes the videos and truth.json to `config.out`; all of them have `config.frames` frames in
    common. Raises InvalidError as `synthesise` does."""
    frames = config.frames + round(MAX_OFFSET_S * config.fps)
    with making_folder(config.out) as folder, TemporaryDirectory() as temporary:
        whole = Path(temporary) / "capture"
        synthesise(replace(config, out=whole, frames=frames, plain=None))
        _write(open_capture(whole), folder, config.seed, config.plain == "silent")


def _write(capture: Capture, out: Path, seed: int, silent: bool) -> None:
    cameras = plain_cameras(capture, seed)
    fps = capture.fps or 30.0
    sound = _claps(capture.num_frames / fps, np.random.default_rng([seed, 2]))
    for index, plain in enumerate(cameras):
        at = _straight_positions(plain, capture.cameras[index].camera)
        video = out / f".{plain.camera.name}.mp4"
        with (
            closing(capture.open_images(index)) as source,
            VideoWriter(video, plain.camera, fps) as writer,
        ):
            for frame in range(plain.first_frame, capture.num_frames):
                writer.write(_sampled(source.read(frame), at))
        rng = np.random.default_rng([seed, 3, index])
        samples = None if silent else _heard(sound, plain, fps, rng)
        _join(video, samples, out / f"{plain.camera.name}.mp4")
        video.unlink()
    truth = [
        plain.camera.to_json() | {"k1": plain.lens.k1, "first_frame": plain.first_frame}
        for plain in cameras
    ]
    (out / TRUTH_NAME).write_text(json.dumps(truth, indent=1))


def _straight_positions(plain: PlainCamera, straight: Camera) -> Doubles:
    """(2, H, W) row and column of the capture's picture that each pixel of the bent one shows."""
    camera = plain.camera
    rows, columns = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    bent = np.stack([(columns - camera.cx_px) / camera.fx_px, (rows - camera.cy_px) / camera.fy_px])
    place = bent
    for _ in range(20):
        place = bent / (1 + plain.lens.k1 * (place**2).sum(axis=0))
    return np.stack(
        [
            place[1] * straight.fy_px + straight.cy_px - 0.5,
            place[0] * straight.fx_px + straight.cx_px - 0.5,
        ]
    )


def _sampled(picture: Picture, at: Doubles) -> Picture:
    planes = [map_coordinates(picture[..., c], at, order=1, mode="nearest") for c in range(3)]
    return np.ascontiguousarray(np.stack(planes, axis=-1))


def _claps(duration_s: float, rng: np.random.Generator) -> Doubles:
    """Mono sound of a whole take, -1 to 1: claps at irregular times."""
    sound = np.zeros(round((duration_s + 1) * SAMPLE_RATE))
    times = [MAX_OFFSET_S + after for after in CLAPS_S]
    while times[-1] < duration_s:
        times.append(times[-1] + float(rng.uniform(0.3, 1.2)))
    length = round(0.08 * SAMPLE_RATE)
    for time_s in times[:-1]:
        at = round(time_s * SAMPLE_RATE)
        fading = np.exp(-np.arange(length) / (0.012 * SAMPLE_RATE))
        sound[at : at + length] += 0.5 * rng.normal(size=length) * fading
    return np.clip(sound, -1, 1)


def _heard(sound: Doubles, plain: PlainCamera, fps: float, rng: np.random.Generator) -> Doubles:
    """What a camera hears of it from its first frame on: later the farther it stands from the
    middle, and with noise of its own."""
    late_s = float(np.linalg.norm(plain.camera.position)) / SOUND_M_PER_S
    first = round((plain.first_frame / fps - late_s) * SAMPLE_RATE)
    heard = np.concatenate([np.zeros(max(0, -first)), sound[max(0, first) :]])
    return np.clip(heard * rng.uniform(0.3, 0.9) + 0.004 * rng.normal(size=len(heard)), -1, 1)


def _join(video: Path, samples: Doubles | None, out: Path) -> None:
    """Copies the pictures of a video, and adds sound to them."""
    with av.open(f"file:{video}") as pictures, av.open(f"file:{out}", "w") as joined:
        source = pictures.streams.video[0]
        target = joined.add_stream_from_template(source)
        sound = None if samples is None else joined.add_stream("aac", rate=SAMPLE_RATE)
        for packet in pictures.demux(source):
            if packet.dts is not None:
                packet.stream = target
                joined.mux(packet)
        if sound is None or samples is None:
            return
        seconds = float((source.duration or 0) * (source.time_base or 0))
        row = np.rint(samples[: round(seconds * SAMPLE_RATE)] * 32000).astype(np.int16)[None]
        frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(row), "s16", "mono")
        frame.sample_rate = SAMPLE_RATE
        for packet in (*sound.encode(frame), *sound.encode(None)):
            joined.mux(packet)

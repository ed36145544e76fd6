"""swings-stream import: from files to a stream, by functions and by processes."""

from __future__ import annotations

import gzip
import os
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.errors import CodecError, InvalidError, UnsupportedError
from codec.framerange import FrameRange
from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.lattice.lattice import Lattice
from codec.sequence.importing import (
    VIEW_TILT_RAD,
    VIEW_TURN_RAD,
    WRITE_STEPS,
    Imported,
    ImportOptions,
    import_stream,
    make_manifest,
)
from codec.sequence.slotfiller import HOLD, KINDS, ErrorBound, steps_of
from codec.sequence.survey import Survey
from codec.splats import Splats
from codec.stream import StreamReader
from codec.stream.wholeslice import Rank
from codec.tools.audit import verify_stream
from player.render.cpu import render_splats
from player.streamcommand import draw_poster
from tests.support.commands import run, run_ok
from tests.support.deforming import Deforming
from tests.support.hostile import refused
from tests.support.trained_like import trained_like_splats

OPTIONS = ImportOptions(fps=30)


def save(path: Path, splats: Splats) -> Path:
    path.parent.mkdir(exist_ok=True)
    write_splats(path, splats, SplatFormat.PLY)
    return path


def by_position(splats: Splats) -> Splats:
    return splats.take(np.lexsort(splats.means.T))


def test_a_still_model(tmp_path: Path) -> None:
    splats = trained_like_splats(300, sh_degree=2)
    save(tmp_path / "model.ply", splats)
    made = import_stream(tmp_path / "model.ply", tmp_path / "stream", OPTIONS)
    manifest = made.manifest
    assert (manifest.swin_size, manifest.num_gs, manifest.sh_degree) == (1, 300, 2)
    assert (manifest.title, manifest.live, made.num_frames) == ("model", False, 1)
    reader = StreamReader(tmp_path / "stream")
    assert reader.num_frames == 1
    found = by_position(reader.active_splats(0, 4))
    assert len(found) == 300
    assert abs(found.means[:, 2] - by_position(splats).means[:, 2]).max() <= made.errors["position"]
    # A layer that paints less is coarser.
    steps = [lattice.colour for lattice in manifest.lattice]
    assert steps == sorted(steps)
    assert steps[0] < steps[-1]
    # What is large fits every layer beside what is very thin: the log-scales get a base.
    splats = splats.take(np.flatnonzero(np.abs(splats.means).max(axis=1) < 4)).with_degree(0)
    splats.log_scales[7, 2] = -15.8  # below 128 steps
    save(tmp_path / "thin.ply", splats)
    import_stream(tmp_path / "thin.ply", tmp_path / "thin", OPTIONS)
    reader = StreamReader(tmp_path / "thin")
    assert any(lattice.log_scale_base for lattice in reader.manifest.lattice)
    decoder = reader.decoder_at(0, reader.manifest.num_layers)
    assert not any(len(slots.escapes) for slots in decoder.lanes[0])


def test_the_default_camera_sees_the_whole_model_from_outside() -> None:
    splats, survey = trained_like_splats(2000, 4), Survey()
    survey.take(Path("model.ply"), splats)
    manifest = make_manifest(survey, ImportOptions(), "", (2000,), (Lattice.suiting(splats),))
    camera = manifest.camera()
    lower, upper = np.array(manifest.bounds)
    corners = np.stack(np.meshgrid(*zip(lower, upper, strict=True)), -1).reshape(-1, 3)
    u_px, v_px, depths = camera.project(corners)
    assert (depths > manifest.near_m).all()
    for pixels, size_px in ((u_px, camera.width_px), (v_px, camera.height_px)):
        assert (pixels >= 0).all()
        assert (pixels <= size_px).all()
    front = manifest.cameras[0]  # level: the horizon goes by it
    assert front.down == pytest.approx((0, 1, 0))
    cosine = np.cos(VIEW_TURN_RAD) * np.cos(VIEW_TILT_RAD)
    assert camera.forward @ front.forward == pytest.approx(cosine)
    middle = (lower + upper) / 2 - camera.position
    assert middle / np.linalg.norm(middle) == pytest.approx(camera.forward)
    inside = ((splats.means >= lower) & (splats.means <= upper)).all(axis=1)
    assert 0.9 < inside.mean() < 1  # floaters are outside


def test_the_focus_is_the_middle_of_what_moves(tmp_path: Path) -> None:
    room = trained_like_splats(100)
    place = room.means[:20].mean(axis=0)
    for name, speed_m in (("still", 0.0), ("moving", 0.05)):
        take = tmp_path / name
        take.mkdir()
        for frame in range(13):
            means = room.means.copy()
            means[:20] = place + 0.1 * means[:20]
            means[:20, 0] += speed_m * (frame - 6)
            write_splats(take / f"{frame}.ply", Splats(means, *room.arrays[1:]), SplatFormat.PLY)
        import_stream(take, tmp_path / f"{name}-s", ImportOptions(fps=30.0), render_splats)
    still, moving = (StreamReader(tmp_path / f"{name}-s").manifest for name in ("still", "moving"))
    assert still.focus is None
    np.testing.assert_allclose(np.array(moving.focus), 1.1 * place, atol=0.1)


def test_a_folder_is_a_sequence_in_order_of_number(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "take"
    # The text order of the names is 10, 2, 6; counts and kinds differ, and one frame is empty.
    parts = {2: trained_like_splats(30), 6: trained_like_splats(50, 1), 14: trained_like_splats(0)}
    for number, splats in parts.items():
        save(folder / f"v1_{number}.ply", splats)
    write_splats(folder / "v1_10.spz", trained_like_splats(40), SplatFormat.SPZ)
    for other in ("notes.txt", ".v1_3.ply.tmp", ".v1_3.ply"):
        (folder / other).write_text("no model")
    options = ImportOptions(24, title="Take", layers=3)
    made = import_stream(folder, tmp_path / "stream", options).manifest
    assert "v1_14.ply (0)" in caplog.text
    assert (made.fps, made.num_gs, made.num_layers, made.title) == (24, 50, 3, "Take")
    reader = StreamReader(tmp_path / "stream")
    assert [len(reader.active_splats(frame, 3)) for frame in range(4)] == [30, 50, 40, 0]
    assert len(set(made.lattice)) == 1
    assert (np.array(made.bounds[0]) < np.array(made.bounds[1])).all()
    verify_stream(tmp_path / "stream")
    options = replace(options, frames=FrameRange(1, 3))
    made = import_stream(folder, tmp_path / "part", options).manifest
    reader = StreamReader(tmp_path / "part")
    assert made.capture_frame == 1
    assert [len(reader.active_splats(frame, 3)) for frame in range(2)] == [50, 40]


def test_files_of_other_programs_become_one_take(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """One folder a frame, as trainers leave them; the second has a value that is not finite."""
    folder, splats = tmp_path / "take", trained_like_splats(30)
    for frame in range(3):
        for iteration in (7000, 30000):
            path = folder / f"frame_{frame}/point_cloud/iteration_{iteration}/point_cloud.ply"
            path.parent.mkdir(parents=True)
            save(path, splats.take(slice(0, 29 + (iteration == 30000))))
    data = bytearray(path.with_name("point_cloud.ply").read_bytes())
    data[-4:] = b"\0\0\xc0\x7f"
    (folder / "frame_1/point_cloud/iteration_30000/point_cloud.ply").write_bytes(data)
    made = import_stream(folder, tmp_path / "stream", OPTIONS)
    reader = StreamReader(tmp_path / "stream")
    assert [len(reader.active_splats(frame, 4)) for frame in range(3)] == [30, 29, 30]
    assert list(made.notes.left_out.values()) == [1]
    [message] = caplog.messages  # although each file is read twice
    assert "frame_1: left out: 1 of 30 Gaussians, the first is number 29;" in message
    assert import_stream(folder / "frame_2", tmp_path / "still", OPTIONS).num_frames == 1
    (folder / "lod-meta.json").write_text("{}")
    says = "a streamed SOG, whose levels of detail are not read; .*--select-lod 0"
    for source in (folder, folder / "lod-meta.json"):
        refused(UnsupportedError, says, import_stream, source, tmp_path / "none", OPTIONS)
    raw = tmp_path / "raw.spz"
    write_splats(raw, splats, SplatFormat.SPZ)
    assert not import_stream(raw, tmp_path / "named", OPTIONS).notes.hint
    content = gzip.decompress(raw.read_bytes())  # without its last record, and the flag of it
    raw.write_bytes(gzip.compress(content[:14] + b"\0\0" + content[16:-12]))
    assert "--turn 180 0 0" in import_stream(raw, tmp_path / "unnamed", OPTIONS).notes.hint


def test_a_bad_folder_or_file_is_named_and_nothing_is_written(tmp_path: Path) -> None:
    folder = tmp_path / "take"
    folder.mkdir()
    stream = tmp_path / "stream"

    def is_refused(says: str, options: ImportOptions = OPTIONS) -> None:
        refused((InvalidError, CodecError), says, import_stream, folder, stream, options)
        assert not [path for path in tmp_path.iterdir() if path != folder]

    is_refused(r"take: no file of Gaussians in this folder .*\.ksplat, \.sog, ")
    save(folder / "frame_1.ply", trained_like_splats(3))
    save(folder / "frame_01.ply", trained_like_splats(3))
    is_refused(r"frame_01\.ply and frame_1\.ply have the same number")
    (folder / "frame_01.ply").rename(folder / "last.ply")
    is_refused(r"last\.ply: its name has no number")
    (folder / "last.ply").rename(folder / "frame_2.ply")
    is_refused(r"take: no file gives the frame rate; .* --fps 30", ImportOptions())
    (folder / "fps.txt").write_text("fast")
    is_refused(r"fps\.txt: does not hold exactly one number", ImportOptions())
    data = (folder / "frame_2.ply").read_bytes()
    (folder / "frame_2.ply").write_bytes(data[:-1])
    is_refused(r"frame_2\.ply: PLY: ends after")
    save(folder / "frame_2.ply", trained_like_splats(3, sh_degree=1))
    is_refused(r"frame_2\.ply: SH degree 1, but the files before have 0")
    (folder / "frame_2.ply").write_bytes(data)
    save(folder / "frame_4.ply", trained_like_splats(3))
    is_refused(r"take: number 3 is missing between frame_2\.ply and frame_4\.ply")
    save(folder / "frame_9.ply", trained_like_splats(3))
    is_refused(r"2 gaps; numbers 3, 5 to 8 are missing; the first is between frame_2\.ply and")
    (folder / "frame_9.ply").unlink()
    (folder / "frame_3.ply").symlink_to("nowhere.ply")
    is_refused(r"take/frame_3\.ply is a broken link; replace or remove it")
    (folder / "frame_3.ply").unlink()
    os.mkfifo(folder / "frame_3.ply")
    is_refused(r"take/frame_3\.ply is not a regular file; replace or remove it")
    (folder / "frame_3.ply").unlink()
    (folder / "frame_4.ply").unlink()
    is_refused("fps 0", ImportOptions(fps=0))
    is_refused("frames 2:3: .*take has frames 0:2", replace(OPTIONS, frames=FrameRange(2, 3)))
    is_refused("no rank is called", replace(OPTIONS, rank="beauty"))  # type: ignore[arg-type]
    for values in ({"opacity": 0.001}, {"finer": 1e9}):
        refused(InvalidError, r"error opacity .*choose 0\.0029 or more", ErrorBound, **values)
    refused(InvalidError, "error size 0: choose more than 0", ErrorBound, size=0)
    refused(InvalidError, "layers 17: choose 1 to 16", ImportOptions, layers=17)
    save(stream, trained_like_splats(1))
    refused(InvalidError, "stream is not empty", import_stream, folder, stream, OPTIONS)
    (folder / "fps.txt").write_text("12.5\n")
    assert import_stream(folder, tmp_path / "s", ImportOptions()).manifest.fps == 12.5


def test_a_file_that_changes_while_it_is_imported_is_named(tmp_path: Path) -> None:
    for number in range(3):
        save(tmp_path / "take" / f"{number}.ply", trained_like_splats(5))

    def grow(done: int, total: int, what: str) -> None:
        if done == 3 + WRITE_STEPS:  # the first frame is written
            save(tmp_path / "take" / "1.ply", trained_like_splats(6))

    with pytest.raises(InvalidError, match=r"1\.ply: changed while it was imported"):
        import_stream(tmp_path / "take", tmp_path / "s", OPTIONS, progress=grow)
    assert [path.name for path in tmp_path.iterdir()] == ["take"]


def moving(folder: Path, num_files: int, count: int = 300) -> Path:
    """Writes a sequence in which a third of the Gaussians moves, as files in `folder`."""
    first = trained_like_splats(count)
    for number in range(num_files):
        means = first.means.copy()
        means[: count // 3] += np.float32(0.01 * number)
        save(folder / f"f_{number:04d}.ply", replace(first, means=means))
    return folder


def test_the_commands(tmp_path: Path) -> None:
    folder = moving(tmp_path / "seq", 3)
    told = run_ok("swings-stream", "import", folder, tmp_path / "s", "--fps", 25).splitlines()
    assert told[0] == f"{tmp_path}/s: seq, up to 300 Gaussians a frame, SH degree 0"
    assert [line.split()[0] for line in told[1:]] == ["frames", "errors", "slots", "PSNR"]
    assert "66.7 % kept, 0.0 % ended, 33.3 % moved, 0.0 % new" in told[3]
    assert verify_stream(tmp_path / "s").num_frames == 3
    poster = Image.open(tmp_path / "s" / "poster.jpg")
    assert (poster.format, poster.size) == ("JPEG", (640, 360))
    assert np.asarray(poster).max() > 60
    [record] = StreamReader(tmp_path / "s").records
    layers_db = record.psnr_db
    assert 20 < layers_db[0] < layers_db[-1]
    assert layers_db[-1] > 40
    out = tmp_path / "out.spz"
    told_out = run_ok("swings-stream", "export", tmp_path / "s", out, "--frame", 2)
    assert told_out == f"{out}: 1 file, {out.stat().st_size} bytes\n"
    assert len(read_splats(out)) == 300
    for words, status, says in (
        ((tmp_path / "none.ply", "other"), 1, [f"swings-stream: {tmp_path}/none.ply is missing\n"]),
        ((folder, tmp_path / "other"), 1, ["add --fps, for example --fps 30"]),
        ((folder, tmp_path / "other", "--error.turn", -1), 2, ["turn"]),
        ((tmp_path / "none.ply", "other", "--rank", "typo"), 2, [*Rank]),
    ):
        done = run("swings-stream", "import", *words, folder=tmp_path)
        assert (done.returncode, done.stdout) == (status, "")
        assert all(text in done.stderr for text in says)
        assert status == 1 or "none.ply" not in done.stderr
    assert not (tmp_path / "other").exists()


def test_memory_does_not_grow_with_the_frames(tmp_path: Path) -> None:
    peaks = []
    for num_files in (12, 48):
        folder = tmp_path / str(num_files)
        first = moving(folder, 1, 1500) / "f_0000.ply"
        for number in range(1, num_files):
            os.link(first, folder / f"f_{number:04d}.ply")
        tracemalloc.start()
        import_stream(folder, tmp_path / f"s{num_files}", replace(OPTIONS, layers=1))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 2 * first.stat().st_size
    assert sum(file.stat().st_size for file in folder.iterdir()) > 40 * first.stat().st_size


COUNT = 400


def imported(source: Path, stream: Path, **options: object) -> Imported:
    return import_stream(source, stream, ImportOptions(fps=30, **options), draw_poster)  # type: ignore[arg-type]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A file with strong harmonics of degree 3."""
    splats = trained_like_splats(COUNT, sh_degree=3)
    splats.sh[:, 9:] *= 5
    return save(tmp_path / "model.ply", splats)


def test_every_degree_counts(model: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    exact = imported(model, tmp_path / "exact", exact=True)
    assert exact.source_sh_degree == exact.manifest.sh_degree == 3
    assert exact.scores_db[0][-1] == 100
    less = imported(model, tmp_path / "less", exact=True, sh_degree=1)
    assert (less.manifest.sh_degree, less.source_sh_degree) == (1, 3)
    # The file is drawn with all its harmonics.
    assert less.scores_db[0][-1] < 45
    assert StreamReader(tmp_path / "less").records[0].psnr_db[-1] < 45
    assert less.num_bytes < 0.6 * exact.num_bytes
    assert caplog.messages == []


def test_a_degree_is_a_most_and_makes_files_of_several_degrees_one_sequence(tmp_path: Path) -> None:
    folder = tmp_path / "seq"
    for number, sh_degree in enumerate((3, 1, 2)):
        save(folder / f"{number}.ply", trained_like_splats(50, sh_degree=sh_degree))
    with pytest.raises(InvalidError, match=r"1\.ply: SH degree 1, but .* 3; .*--sh-degree 1 "):
        imported(folder, tmp_path / "s")
    made = imported(folder, tmp_path / "s", sh_degree=1)
    assert (made.manifest.sh_degree, made.source_sh_degree) == (1, 3)
    plain = save(tmp_path / "plain.ply", trained_like_splats(50))
    assert imported(plain, tmp_path / "p", sh_degree=3).manifest.sh_degree == 0
    refused(InvalidError, "sh-degree 4: choose 0 to 3", ImportOptions, sh_degree=4)


def test_errors_go_by_what_is_seen_of_them(tmp_path: Path) -> None:
    """With harmonics of degree 3, pictures get better, and moving frames do not get larger."""
    deforming = Deforming(3000, 3)
    for number in range(3):
        save(tmp_path / "seq" / f"{number}.ply", deforming.next())
    evenly = imported(tmp_path / "seq", tmp_path / "evenly", by_paint=False)
    made = imported(tmp_path / "seq", tmp_path / "made")
    assert len(set(evenly.manifest.lattice)) == 1
    position_m = [lattice.position_m for lattice in made.manifest.lattice]
    assert position_m == sorted(position_m)
    assert position_m[-1] > 2 * position_m[0]
    assert made.scores_db[0][-1] > evenly.scores_db[0][-1] + 3
    moved = [one.played_bytes - one.first_bytes for one in (made, evenly)]
    assert moved[0] < 1.05 * moved[1]
    for number, kind in enumerate(KINDS):
        steps = [steps_of(lattice)[number] for lattice in made.manifest.lattice]
        assert made.errors[kind] <= HOLD * max(steps) * (1 + 1e-4)

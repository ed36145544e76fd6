"""The comparison of choices for slots that last, at its smallest: it counts bytes, runs, draws."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console

import bench.ablate
from bench.ablate import measure
from bench.leases import CHOSEN, LeasesConfig, draw, examine, recoded, settings, table_of
from codec.slots.update import PREDICTED
from codec.stream import StreamReader
from codec.stream.manifest import MASKS
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import small_layout
from tests.support.tiny_capture import write_dynamic3dgs

FRAMES = 9


@pytest.mark.parametrize("swin_size", [1, 3])
def test_what_is_coded_again_is_the_same_but_for_the_prediction(
    swin_size: int, tmp_path: Path
) -> None:
    layout = small_layout(swin_size, (40, 20), 0, 4)
    updates = write_slots(tmp_path, FRAMES, layout)
    assert any((update.statuses == PREDICTED).any() for update in updates)
    assert any(len(update.escapes) for update in updates)
    reader = StreamReader(tmp_path)
    there = [
        [
            reader.read_object(reader.manifest.segment_of(birth), part).packet(birth)
            for part in (MASKS, 0, 1)
        ]
        for birth in range(1, FRAMES)
    ]
    assert list(recoded(reader, predicts=True)) == there
    without = list(recoded(reader))
    assert without != there
    found = examine(reader)
    sizes = [sum(map(len, packets)) for packets in without]
    assert found["unpredicted_bytes"] == sum(sizes) / (FRAMES - 1)
    first = [(tmp_path / f"segments/0/snapshot-{n}").stat().st_size for n in (0, 1)]
    assert found["first_bytes"] == sum(first)


def test_each_setting_changes_one_choice() -> None:
    chosen, *others = settings(LeasesConfig(Path("capture")))
    assert chosen.name == CHOSEN
    assert len({other.name for other in others}) == len(others) >= 12
    assert not any(setting.whole_slices for setting in (chosen, *others))
    assert [s.name for s in others if s.fit.lease.active_share == 1] == [
        "active_share 1, no leases"
    ]
    # A value of the base setting is not trained twice.
    again = settings(LeasesConfig(Path("capture"), sizes=(10_000, 5_000)))
    assert [s.name for s in again if s.group == "num_gs"] == ["num_gs 5,000"]


def test_it_measures_once_and_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_dynamic3dgs(tmp_path / "capture", num_cameras=4, num_frames=3)
    config = LeasesConfig(
        tmp_path / "capture",
        out=tmp_path / "plots" / "leases.png",
        work=tmp_path / "work",
        frames="0:3",
        scale=1.0,
        genesis_iterations=3,
        window_iterations=2,
        num_gs=60,
        settle_rounds=1,
        active_shares=(1.0,),
        swin_sizes=(2,),
        sizes=(30,),
        settlings=(0,),
        prefix_shares=(0.5,),
        settle_prefix_shares=(0.0,),
        holds=(2.0,),
    )
    outcomes = measure(config, settings(config), examine)
    assert list(outcomes) == settings(config)
    for (found,) in outcomes.values():
        assert found.psnr_db > 3
        assert len(found.layers_db) == 4
        assert min(found.bytes_per_frame, *found.more.values()) > 0

    def fail(*arguments: object) -> None:
        raise AssertionError("trained again")

    monkeypatch.setattr(bench.ablate, "train_stream", fail)
    assert measure(config, settings(config), examine) == outcomes
    console = Console(width=150)
    with console.capture() as shown:
        console.print(table_of(outcomes))
    assert all(setting.name in shown.get() for setting in outcomes)
    draw(outcomes, config)
    assert config.out.read_bytes().startswith(b"\x89PNG")

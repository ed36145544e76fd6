"""The comparisons of choices at their smallest: they run, keep their results, count and draw."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

import bench.ablate
from bench import ablate, leases
from bench.ablate import AblateConfig
from bench.leases import CHOSEN, LeasesConfig, examine, recoded
from codec.slots.update import PREDICTED
from codec.stream import StreamReader
from codec.stream.manifest import MASKS
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import small_layout
from tests.support.tiny_capture import write_dynamic3dgs

FRAMES = 9
TINY: dict[str, Any] = {
    "frames": "0:3", "scale": 1.0, "genesis_iterations": 3, "window_iterations": 2,
}  # fmt: skip


def ablate_config(folder: Path) -> AblateConfig:
    return AblateConfig(
        folder / "capture", out=folder / "plots" / "a.png", work=folder / "work", age_num_gs=60,
        age_swin_size=2, swin_sizes=(1, 2), slice_size=40, seeds=1, **TINY,
    )  # fmt: skip


def leases_config(folder: Path) -> LeasesConfig:
    return LeasesConfig(
        folder / "capture", out=folder / "plots" / "a.png", work=folder / "work", num_gs=60,
        settle_rounds=1, active_shares=(1.0,), swin_sizes=(2,), sizes=(60, 30), settlings=(0,),
        prefix_shares=(0.5,), settle_prefix_shares=(0.0,), holds=(2.0,), **TINY,
    )  # fmt: skip


@pytest.mark.parametrize("what", ["ablate", "leases"])
def test_it_measures_once_and_draws(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_dynamic3dgs(tmp_path / "capture", num_cameras=4, num_frames=3)
    program: Any = {"ablate": ablate, "leases": leases}[what]
    config: Any = {"ablate": ablate_config, "leases": leases_config}[what](tmp_path)
    more = (examine,) if what == "leases" else ()
    settings = program.settings(config)
    # A value of the base setting is not trained twice.
    assert len({repr(setting.fit) for setting in settings}) == len(settings)
    if what == "leases":
        chosen, *others = (setting.name for setting in settings)
        assert chosen == CHOSEN
        assert "active_share 1, no leases" in others
    outcomes = ablate.measure(config, settings, *more)
    assert list(outcomes) == settings
    assert {setting.whole_slices for setting in outcomes} == {what == "ablate"}
    for (found,) in outcomes.values():
        assert found.psnr_db > 3
        assert len(found.layers_db) == 4
        assert all(value > 0 for value in (found.bytes_per_frame, *found.more.values()))

    def fail(*arguments: object) -> None:
        raise AssertionError("trained again")

    monkeypatch.setattr(bench.ablate, "train_stream", fail)
    assert ablate.measure(config, settings, *more) == outcomes
    console = Console(width=150)
    with console.capture() as shown:
        console.print(program.table_of(outcomes))
    assert all(setting.name in shown.get() for setting in outcomes)
    program.draw(outcomes, config)
    assert config.out.read_bytes().startswith(b"\x89PNG")


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

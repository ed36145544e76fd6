"""swings-play: a stream in a window or into files."""

from __future__ import annotations

from pathlib import Path

from codec.console import run_command, say

from .config import PlayConfig


def run(config: PlayConfig) -> None:
    # What most plays have no use for loads slowly.
    if config.draws_frames:
        from .run.stills import draw_frames

        say(draw_frames(config))
    elif config.profile is not None:
        run_profile(config, config.profile)
    else:
        from .run.playback import play

        for line in play(config).lines():
            say(line)


def run_profile(config: PlayConfig, path: Path) -> None:
    from rich.console import Console

    from player.report.plots import write_stage_plot

    from .report.stages import profile

    found = profile(config)
    Console(width=100).print(found.table())
    write_stage_plot(path, found)


def main() -> None:
    run_command(
        PlayConfig, run, "swings-play", "Plays a stream in a window, or writes its frames to files."
    )


if __name__ == "__main__":
    main()

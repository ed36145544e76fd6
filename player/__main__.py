"""swings-play: a stream in a window, in a browser, or into files."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from codec.console import run_command, say

from .config import PlayConfig
from .playback import play
from .stills import draw_still
from .viserview import show_in_viser


def run(config: PlayConfig) -> None:
    if config.viser is not None:
        show_in_viser(config)
    elif config.still is not None:
        say(draw_still(config))
    elif config.profile is not None:
        run_profile(config, config.profile)
    else:
        for line in play(config).lines():
            say(line)


def run_profile(config: PlayConfig, path: Path) -> None:
    # They load slowly, and few plays are profiled.
    from .stageplot import write_stage_plot
    from .stages import profile

    found = profile(config)
    Console(width=100).print(found.table())
    write_stage_plot(path, found)


def main() -> None:
    run_command(PlayConfig, run, "swings-play", "Plays a stream in a window or into files.")


if __name__ == "__main__":
    main()

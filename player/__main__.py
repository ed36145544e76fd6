"""swings-play: a stream in a window or into files."""

from __future__ import annotations

from codec.console import run_command, say

from .config import PlayConfig
from .playback import play
from .stills import draw_still
from .viserview import show_in_viser


def run(config: PlayConfig) -> None:
    if config.viser is not None:
        show_in_viser(config)
        return
    if config.still is not None:
        say(draw_still(config))
        return
    for line in play(config).lines():
        say(line)


def main() -> None:
    run_command(PlayConfig, run, "swings-play", "Plays a stream in a window or into files.")


if __name__ == "__main__":
    main()

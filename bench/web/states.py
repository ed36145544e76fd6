"""Pictures of the browser player in each of its states, and of the server's pages, on a phone, a
laptop and a large screen.

    scripts/bench states FOLDER [--states menu ended gallery-of-200] [--screens phone]

Look at them after each change of the controls or the pages.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from codec.console import run_command
from codec.errors import InvalidError
from tests.support.web.chromium import running_chromium, why_not
from tests.support.web.galleries import PAGES, serving
from tests.support.web.playerstates import SCREENS, STATES, Reached, Screen, hosting


@dataclass(frozen=True, slots=True)
class StatesConfig:
    """Writes pictures of the browser player in each of its states, and of the server's pages."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder for the pictures, STATE-SCREEN.png."""
    states: tuple[str, ...] = (*STATES, *PAGES)
    """States and pages to show."""
    screens: tuple[str, ...] = tuple(screen.name for screen in SCREENS)
    """Screens to show them on."""


def run(config: StatesConfig) -> None:
    reason = why_not()
    if reason is not None:
        raise InvalidError(reason)
    config.folder.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as streams,
        hosting(Path(streams)) as hosts,
        running_chromium() as page,
    ):
        screens = [screen for screen in SCREENS if screen.name in config.screens]

        def show(state: str, screen: Screen, reach: Callable[[], None], part: str | None) -> None:
            reach()
            page.screenshot(config.folder / f"{state}-{screen.name}.png")
            found = "; ".join(page.axe(part)) or "accessible"
            print(f"{state:24} {screen.name:8} {found}", flush=True)

        for state in config.states:
            if state in STATES:
                for screen in screens:
                    reached = Reached(page, hosts, screen)
                    show(state, screen, partial(STATES[state], reached), "swings-player")
            else:
                count, reach = PAGES[state]
                with tempfile.TemporaryDirectory() as root, serving(Path(root), count) as url:
                    for screen in screens:
                        show(state, screen, partial(reach, page, url, screen), None)


if __name__ == "__main__":
    run_command(StatesConfig, run, "scripts/bench states", "Shows the player and the pages.")

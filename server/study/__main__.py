"""swings-abr: policies compared over throughput traces."""

from __future__ import annotations

from contextlib import ExitStack

from rich.console import Console

from codec.console import run_command
from codec.files import making_folder
from codec.progressline import counted

from .config import StudyConfig


def run(config: StudyConfig) -> None:
    from .report import table_of, write_plays  # matplotlib loads slowly
    from .study import run_study

    with ExitStack() as stack:
        # Before the plays, which may take long.
        folder = None if config.out is None else stack.enter_context(making_folder(config.out))
        with counted("simulating") as progress:
            plays = run_study(config, progress)
        if folder is not None:
            write_plays(folder, plays)
    Console().print(table_of(plays))
    if config.out is not None:
        print(f"plays        {config.out / 'plays.csv'}, {config.out / 'plays.png'}")


def main() -> None:
    run_command(StudyConfig, run, "swings-abr", "Simulates policies over throughput traces.")


if __name__ == "__main__":
    main()

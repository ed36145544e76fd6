"""swings-abr: policies compared over throughput traces."""

from __future__ import annotations

from rich.console import Console

from codec.console import run_command
from codec.progressline import counted

from .config import StudyConfig


def run(config: StudyConfig) -> None:
    from .report.study import run_study  # matplotlib and scipy load slowly
    from .report.tables import terminal_table

    with counted("simulating") as progress:
        summaries = run_study(config, progress)
    Console().print(terminal_table(summaries))
    print(f"report       {config.out / 'index.html'}")


def main() -> None:
    run_command(StudyConfig, run, "swings-abr", "Simulates policies over throughput traces.")


if __name__ == "__main__":
    main()

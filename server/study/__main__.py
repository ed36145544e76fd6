"""swings-abr: policies compared over throughput traces."""

from __future__ import annotations

from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn

from codec.console import run_command

from .config import StudyConfig


def run(config: StudyConfig) -> None:
    from .report.study import run_study  # matplotlib and scipy load slowly
    from .report.tables import terminal_table

    console = Console(stderr=True)
    columns = (*Progress.get_default_columns()[:2], MofNCompleteColumn(), TimeRemainingColumn())
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task("cases")
        summaries = run_study(config, lambda done, of: bar.update(task, completed=done, total=of))
    Console().print(terminal_table(summaries))
    print(f"report       {config.out / 'index.html'}")


def main() -> None:
    run_command(StudyConfig, run, "swings-abr", "Simulates policies over throughput traces.")


if __name__ == "__main__":
    main()

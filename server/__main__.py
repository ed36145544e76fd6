"""swings-serve: streams over HTTP."""

from __future__ import annotations

from codec.console import run_command, say

from .listener import bind, check_public, url_of
from .operate.settings import settings_parser, settings_text
from .servecommand import PREFIX, SAMPLE, ServeCommand
from .serving import check_files, serve_alone, serve_with_workers


def run(command: ServeCommand) -> None:
    config = command.server
    if command.check_config:
        say(settings_text(PREFIX, command).rstrip("\n"))
    command.check()
    check_files(config)
    if command.check_config:
        return
    listener = bind(command.host, command.port)
    check_public(listener, config)
    url = url_of(listener, "http" if config.tls_cert is None else "https")
    more = f"\nwatch it in a browser: {url}/watch/{SAMPLE.stem}" if command.sample else ""
    if config.keys is not None:
        more = f"\nopens with links of: swings-sign {config.keys} STREAM --url {url}"
    serve = serve_with_workers if config.supervisor.workers > 1 else serve_alone
    serve(command, listener, lambda: print(f"serving {url}{more}", flush=True))


def main() -> None:
    run_command(
        ServeCommand,
        run,
        "swings-serve",
        "Serves streams over HTTP.",
        settings_parser(PREFIX),
    )


if __name__ == "__main__":
    main()

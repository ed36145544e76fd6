"""A plain aiohttp response from memory, as a reference: `python bareresponse.py FOLDER`.

It checks nothing, logs nothing and handles no conditional requests: the minimum cost of aiohttp.
Prints the port once it listens, and serves FOLDER under /v1/streams/ until it is stopped.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from aiohttp import web


def read_bodies(root: Path) -> dict[str, bytes]:
    """The body of each path."""
    files = [path for path in root.rglob("*") if path.is_file()]
    return {f"/v1/streams/{path.relative_to(root)}": path.read_bytes() for path in files}


async def serve(bodies: dict[str, bytes]) -> None:
    async def answer(request: web.BaseRequest) -> web.StreamResponse:
        body = bodies.get(request.path)
        return web.Response(body=body, status=200 if body is not None else 404)

    runner = web.ServerRunner(web.Server(answer, access_log=None))
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    print(runner.addresses[0][1], flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(serve(read_bodies(Path(sys.argv[1]))))

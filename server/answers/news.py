"""POST /v1/streams/{stream}/play/{play}: a client tells how its playback stands.

Rule: a flood of news costs what its requests cost, and no more. The play looks at the newest only,
when it would look at its client anyway.
"""

from __future__ import annotations

from codec.errors import InvalidError
from server.abr.standing import RATE_HEADER, Standing
from server.http.errors import RequestError
from server.http.response import Response
from server.state.register import NewsOutcome

from .call import Call


def take_news(call: Call) -> Response:
    """204, or an error that says what is wrong with it."""
    plays = call.state.plays
    token, stream = call.names["play"], call.name("stream")
    outcome = NewsOutcome.REFUSED
    try:
        if plays.find(token, stream) is None:
            outcome = NewsOutcome.UNKNOWN
        else:
            outcome = plays.tell(token, stream, Standing.from_json(call.request.body))
    except InvalidError as error:
        raise RequestError(400, f"news of a play: {error}") from error
    finally:
        call.state.metrics.play_news.add(1, outcome)
    entry = plays.find(token, stream)
    if entry is None:
        raise RequestError(404, "there is no such play, or it is over")
    fields = {"Cache-Control": "no-store"}
    if entry.rate_bps is not None:
        fields[RATE_HEADER] = str(round(entry.rate_bps))
    return Response(204, fields)

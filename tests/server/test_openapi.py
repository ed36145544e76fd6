"""docs/openapi.yaml describes a real swings-serve: every route, and any request."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import schemathesis
from aiohttp import web
from hypothesis import HealthCheck, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.core.result import Ok
from schemathesis.generation import GenerationMode
from schemathesis.schemas import BaseSchema
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from server.app import ROUTES
from tests.server.hostile.serverprocess import ServerProcess, server_process
from tests.support.commands import ROOT
from tests.support.hosted_streams import write_stream
from tests.support.waiting import BOUND_S

DOCUMENT = ROOT / "docs" / "openapi.yaml"
HELD = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]
UNSERVED = {"GET /v1/streams/{stream}/oembed.json"}
"""Operations that answer 501 to a request for another format, as oEmbed requires."""
EXAMPLES = [25, pytest.param(300, marks=pytest.mark.deep)]
"""Requests of each kind for each operation."""
NOTHING_TO_GET_WRONG = {"GET /", "GET /healthz", "GET /readyz", "GET /metrics", "GET /v1/streams"}
LIKELY: dict[str, list[object]] = {
    "segment": [0, 2, 3],
    "layer": ["0", "2", "9", "skipmaps"],
    "asset": ["watch.html", "nothing.js"],
    "picture": ["poster.png", "other.jpg"],
}
"""Parameters that are often requested, existing or possible ones."""


def served_routes() -> set[tuple[str, str]]:
    """Methods and paths of all routes of the server."""
    router = web.UrlDispatcher()
    router.add_routes(ROUTES)
    return {
        (route.method.lower(), route.resource.canonical)
        for route in router.routes()
        if route.method != "HEAD" and route.resource is not None
    }


def described_routes(document: dict[str, Any]) -> set[tuple[str, str]]:
    return {(method, path) for path, methods in document["paths"].items() for method in methods}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("openapi")
    write_stream(root / "walk", 12, poster="poster.png")
    (root / "walk" / "poster.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    return root


@pytest.fixture(scope="module")
def server(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    with server_process(root, tmp_path_factory.mktemp("log")) as running:
        yield running
    assert "Traceback" not in running.log.read_text()


def made_likely() -> BaseSchema:
    """The document, with mostly existing streams and objects."""
    raw = schemathesis.openapi.from_path(DOCUMENT).raw_schema
    raw["components"]["parameters"]["stream"]["schema"] = {"enum": ["walk", "nobody"]}
    for methods in raw["paths"].values():
        for operation in methods.values():
            for parameter in operation.get("parameters", ()):
                if parameter.get("name") in LIKELY:
                    parameter["schema"] = {"enum": LIKELY[parameter["name"]]}
    return schemathesis.openapi.from_dict(raw)


OPERATIONS = {
    one.ok().label: one.ok() for one in made_likely().get_all_operations() if isinstance(one, Ok)
}


def test_every_route_is_described_and_every_description_is_of_a_route(root: Path) -> None:
    document = schemathesis.openapi.from_path(DOCUMENT).raw_schema
    assert described_routes(document) == served_routes()
    assert {label.lower() for label in OPERATIONS} == {
        f"{method} {path}".lower() for method, path in described_routes(document)
    }


def test_it_is_a_valid_openapi_document() -> None:
    document = schemathesis.openapi.from_path(DOCUMENT)
    document.validate()
    for kind, name in re.findall(r"#/components/(\w+)/(\w+)", DOCUMENT.read_text()):
        assert name in document.raw_schema["components"][kind], name


@pytest.mark.parametrize("examples", EXAMPLES)
@pytest.mark.parametrize(
    ("label", "mode"),
    [
        pytest.param(label, mode, id=f"{label}-{mode.value}")
        for label in OPERATIONS
        for mode in GenerationMode
        if mode is GenerationMode.POSITIVE or label not in NOTHING_TO_GET_WRONG
    ],
)
def test_whatever_is_asked_is_answered_as_described(
    label: str, mode: GenerationMode, examples: int, server: ServerProcess
) -> None:
    """Requests that the document allows, and requests that it does not."""

    @given(case=OPERATIONS[label].as_strategy(generation_mode=mode))
    @settings(
        max_examples=examples,
        derandomize=True,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    def check(case: schemathesis.Case[Any]) -> None:
        checks = [one for one in HELD if one is not not_a_server_error or label not in UNSERVED]
        url = f"http://127.0.0.1:{server.port}"
        case.call_and_validate(base_url=url, checks=checks, timeout=BOUND_S)

    check()

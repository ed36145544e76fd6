"""The environment variables that name the endpoint and the credentials of an object store."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping

from codec.errors import InvalidError

from .credentials import without_credentials

ENDPOINTS = {
    "AWS_ENDPOINT_URL_S3": "AWS_ALLOW_HTTP",
    "AWS_ENDPOINT_URL": "AWS_ALLOW_HTTP",
    "AWS_ENDPOINT": "AWS_ALLOW_HTTP",
    "AZURE_STORAGE_ENDPOINT": "AZURE_ALLOW_HTTP",
    "AZURE_ENDPOINT": "AZURE_ALLOW_HTTP",
}
"""Each variable from which obstore reads an endpoint, and the one that allows or forbids http://."""


def settle_endpoints(environment: MutableMapping[str, str]) -> None:
    """Allows http:// where an endpoint begins with it, unless a variable already says otherwise.

    Written to `environment`, because options that are passed to obstore would replace all others
    that it reads there, such as AWS_TIMEOUT. Raises InvalidError for an endpoint that is no URL:
    obstore panics at its first request.
    """
    for name, allow in ENDPOINTS.items():
        endpoint = environment.get(name)
        if endpoint is None:
            continue
        scheme = endpoint.partition("://")[0].lower()
        if scheme not in ("http", "https"):
            raise InvalidError(
                f"{name} is {without_credentials(endpoint)!r}; set it to a URL that begins with "
                "https:// or http://, or unset it"
            )
        if scheme == "http":
            environment.setdefault(allow, "true")


CREDENTIALS = (
    "AWS_ACCESS_KEY_ID",
    "AWS_SECRET_ACCESS_KEY",
    "AWS_SKIP_SIGNATURE",
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
)
"""The variables from which obstore gets credentials of S3, or learns that none are needed."""


def names_credentials(environment: Mapping[str, str]) -> bool:
    """Whether one of CREDENTIALS is set. If none is, only a machine of a cloud has credentials."""
    return any(name in environment for name in CREDENTIALS)

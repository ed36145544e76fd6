"""The server's own error; what a client did wrong is an HTTP status, not one of these."""

from codec.errors import SwingsError


class ServerError(SwingsError):
    """The server cannot start, or go on, with what it was given."""

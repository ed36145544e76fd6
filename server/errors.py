"""The errors that end the server; what is wrong with a request stands in http/errors.py."""

from codec.errors import SwingsError


class ServerError(SwingsError):
    """The server cannot start, or go on, with what it was given."""

"""The errors of swings, split by who must act.

Every error that a user can meet derives from `SwingsError`; its message is one line that says what
is wrong, where, and what to do. Foreign exceptions are translated at the seam where they rise.
"""


class SwingsError(Exception):
    """Something the user can understand and mend; a command prints it in one line and exits
    with 1."""


class CodecError(SwingsError):
    """Bytes or files of a stream cannot be used."""


class CorruptError(CodecError):
    """The bytes break a rule of the format: truncated, altered, or never of this format."""


class UnsupportedError(CodecError):
    """The bytes may be right, but this version cannot read them."""


class InvalidError(SwingsError, ValueError):
    """An argument breaks a rule of the called function; the caller must change it."""

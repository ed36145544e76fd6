"""The errors of swings, split by who must act on them.

Every error that a user can meet derives from `SwingsError`; its message is one line that says what
is wrong, where, and what to do. Foreign exceptions are translated at the seam where they rise.
"""

from __future__ import annotations

from typing import Self


class SwingsError(Exception):
    """Something the user can understand and mend; a command prints it in one line and exits
    with 1."""


class CodecError(SwingsError):
    """Bytes or files of a stream cannot be used.

    `at` is the offset of the first byte that may be wrong, in the bytes that were parsed; None
    where it is not known.
    """

    def __init__(self, message: str, at: int | None = None) -> None:
        super().__init__(message)
        self.at = at

    def reworded(self, message: str, at: int | None) -> Self:
        """An error of the same kind with another message and place."""
        return type(self)(message, at)

    def moved(self, begin: int) -> Self:
        """This error as one of longer bytes, in which the parsed ones begin at `begin`."""
        return self.reworded(str(self), None if self.at is None else begin + self.at)

    def within(self, name: object, begin: int = 0) -> Self:
        """This error as one of the file `name`, in which the parsed bytes begin at `begin`."""
        moved = self.moved(begin)
        place = "" if moved.at is None else f"byte {moved.at}: "
        return moved.reworded(f"{name}: {place}{self}", moved.at)


class CorruptError(CodecError):
    """The bytes break a rule of the format: truncated, altered, or never of this format."""


class MissingFolderError(CorruptError, FileNotFoundError):
    """The folder that the caller named does not exist, for which Python has a class as well."""


class UnreadableError(CorruptError):
    """A file exists but cannot be read now: no permission, no descriptor left, a store that does
    not answer. A later try may succeed."""


class UnwritableError(CodecError):
    """A store does not take what is to be written. The same may be well later."""


class ConflictError(UnwritableError):
    """Another process is writing the same, or has written in the meantime."""


class UnsupportedError(CodecError):
    """The bytes may be right, but this version cannot read them."""


class InvalidError(SwingsError, ValueError):
    """An argument breaks a rule of the called function; the caller must change it."""

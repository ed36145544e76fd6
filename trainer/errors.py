"""The errors of the training side; each message is one line: what, where, what to do."""

from __future__ import annotations

from codec.errors import SwingsError


class CaptureError(SwingsError):
    """A capture on disk cannot be used, or a new one cannot be written where it was asked for."""


class CheckpointError(SwingsError):
    """A run cannot be resumed from what lies on disk."""

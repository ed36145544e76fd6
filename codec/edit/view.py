"""View: what a stream opens with, and its title. No Gaussian changes."""

from __future__ import annotations

from dataclasses import dataclass, replace

from codec.errors import InvalidError
from codec.stream.manifest import Manifest
from codec.stream.views import view_from_text

from .edit import Edit


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """A new first view, a new title, or both."""

    view: str | None = None
    """The view to open with, as the link button of the browser player writes it: what stands behind
    view= in the link. Write --view=-1.1,0.2,1,0,0 if it begins with a minus."""
    camera: str | None = None
    """The camera of the stream to open with."""
    title: str | None = None
    """The new title."""


class View(Edit):
    """Changes the manifest alone, so that segments are copied byte for byte."""

    def __init__(self, options: ViewOptions) -> None:
        """Raises InvalidError for options that do not go together."""
        if options.view is not None and options.camera is not None:
            raise InvalidError("--view cannot be combined with --camera")
        if options.view is None and options.camera is None and options.title is None:
            raise InvalidError("nothing to change; give --view, --camera or --title")
        self._options = options

    def manifest(self, source: Manifest) -> Manifest:
        options = self._options
        if options.title is not None:
            source = replace(source, title=options.title)
        if options.camera is not None:
            name = source.camera(options.camera).name
            return replace(source, default_camera=name, view=None)
        if options.view is not None:
            view = view_from_text(options.view, source)
            return replace(source, view=replace(view, name="view"))
        return source

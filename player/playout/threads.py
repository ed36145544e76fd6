"""Streaming and rendering in step: the threads of the paper's Algorithm 2.

receive_thread puts the packets that the stream brings into the events queue, and does nothing else:
while a socket is not read a server sees a slow link. update_thread waits until a frame is due,
decodes what came into use with it and puts it into the renderer; render_thread, or the loop of a
window, draws. Each stage is bounded and waits for the next one. An error travels down the line and
rises in render_thread, which runs in the caller's thread, as windows and OpenGL want it.
status_thread stands beside the line: it sends the server the state of the playback, and nothing
waits for it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from codec.arrays import Floats
from player.network.fetch import StoppedError
from player.render.renderer import Renderer
from player.source.source import Source
from player.view.path import CameraPath

from .assembler import Assembler
from .clock import OutputTimes, Picture
from .queues import Events, Handoff
from .timeline import FrameRecord

STATUS_LEAST_S = 0.1
"""Least time between two status reports, seconds."""


@dataclass(frozen=True, slots=True)
class Joined:
    """A stream that was asked for, and how it is to be seen."""

    source: Source
    events: Events
    path: CameraPath


def receive_thread(source: Source, events: Events) -> None:
    """Reads the stream into the events queue."""
    try:
        token = source.play.token
        for packets in source.packets():
            if source.play.token != token:
                token = source.play.token
                events.reconnected()
            events.append(packets)
        events.finish()
    except StoppedError:
        pass
    except BaseException as error:
        events.fail(error)


def update_thread(
    events: Events, assembler: Assembler, renderer: Renderer, handoff: Handoff
) -> None:
    """Moves what came into use with each frame into the renderer when it is due."""
    try:
        while True:
            handoff.wait_for_room()
            due = events.wait_for_frame()
            if due is None:
                break
            began_s = time.perf_counter()
            slices = assembler.assemble(due.record.frame, due.packets, events.shows_between)
            for slice in slices:
                renderer.put(slice)
            handoff.put(replace(due.record, decode_s=time.perf_counter() - began_s))
        handoff.finish()
    except StoppedError:
        pass
    except BaseException as error:
        handoff.finish(error)


def render_thread(
    handoff: Handoff,
    renderer: Renderer,
    path: CameraPath,
    times: OutputTimes,
    first_frame: int,
    show: Callable[[FrameRecord | None, Iterator[Floats]], None],
) -> int:
    """Hands every frame once, in order, to `show`, with the pictures to draw of it, and at last
    None with those behind the last frame. Gives the number of frames.

    first_frame: frames of the film that earlier plays have drawn.
    """
    record: FrameRecord | None = None
    frame = first_frame - 1

    def draw(pictures: Iterable[Picture]) -> Iterator[Floats]:
        assert record is not None
        for picture in pictures:
            renderer.glide(picture.share)
            camera = path(record.frame + float(picture.position - frame))
            yield renderer.render_again(record.frame, camera)

    while (following := handoff.get()) is not None:
        record, frame = following, frame + 1
        renderer.upload(record.frame)
        show(record, draw(times.with_frame(frame)))
    if record is not None:
        show(None, draw(times.behind(frame)))
    return frame + 1 - first_frame


def status_thread(source: Source, events: Events) -> None:
    """Sends the server the state of the playback, as long as it listens."""
    while (status := events.client_status(STATUS_LEAST_S, source.report_s)) is not None:
        if not source.send_status(status):
            break


class Threads:
    """All threads but the caller's; leaving the `with` block ends them, whatever happened.

    receive_thread and status_thread start at once, so that the stream arrives while a renderer is
    made.
    """

    def __init__(
        self, source: Source, events: Events, ended: Callable[[], None] = lambda: None
    ) -> None:
        """ended: is called, by some thread, when receive_thread and when update_thread ends."""
        self._source, self._events, self._ended = source, events, ended
        self._handoff = Handoff()
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> Threads:
        self._start("receive", self._then_ended(receive_thread), self._source, self._events)
        self._start("status", status_thread, self._source, self._events)
        return self

    def update(self, renderer: Renderer) -> Handoff:
        """Starts update_thread; gives where it hands over its frames. Call it once."""
        source = self._source
        first = source.frames.first
        assembler = Assembler(source.manifest, source.num_layers, first, mends=source.adaptive)
        self._start(
            "update",
            self._then_ended(update_thread),
            self._events,
            assembler,
            renderer,
            self._handoff,
        )
        return self._handoff

    def _then_ended(self, target: Callable[..., None]) -> Callable[..., None]:
        def run(*arguments: object) -> None:
            target(*arguments)
            self._ended()

        return run

    def _start(self, name: str, target: Callable[..., None], *arguments: object) -> None:
        thread = threading.Thread(target=target, args=arguments, name=name)
        thread.start()
        self._threads.append(thread)

    def __exit__(self, *error: object) -> None:
        self._handoff.stop()
        self._events.stop()
        self._source.interrupt()
        for thread in self._threads:
            thread.join()

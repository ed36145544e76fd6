"""One playback from its options to its end: opens everything, runs the threads, sums up."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from typing import TYPE_CHECKING

from codec.arrays import Floats
from codec.camera import Camera
from codec.framerange import FrameRange
from codec.progressline import Counter, counted
from player.config import NO_CAPTIONS, PlayConfig
from player.link.linkprocess import LinkProcess
from player.playout.clock import Clock, DeviceTime, OutputTimes, Smoothing
from player.playout.conductor import Conductor
from player.playout.queues import Events
from player.playout.threads import Joined, Threads, render_thread
from player.playout.timeline import FrameRecord, Playout, QueueConfig
from player.rehearsal import rehearse
from player.render.gl import GlError, create_renderer
from player.render.renderer import Renderer, RendererKind
from player.report.journal import (
    MAX_ROWS,
    Journal,
    PlayedOnce,
    PlaySummary,
    SoundCounts,
    write_report,
)
from player.show.background import BLACK, on_background
from player.show.backgroundtask import BackgroundTask
from player.show.sink import VIDEO_SUFFIX, FrameSink, to_bytes
from player.source.opener import Opener, Preview, check_url, is_url
from player.source.source import Source
from player.view.path import CameraPath, Size
from server.abr.link import Link
from server.abr.playout import PlayoutConfig

if TYPE_CHECKING:
    from player.show.glwindow import GlWindow
    from player.show.window import PosterScreen
    from player.sound.soundplayer import SoundPlayer
    from player.sound.soundtrack import SoundTrack

WINDOW_PLAYOUT = PlayoutConfig(longest_lead_s=4.0, conceal_s=0.15)
"""A link that is too slow plays in few long pieces rather than many short ones. A picture that
stands still for a moment is hardly seen; one that is late from then on is."""


CAPTURE_QUEUE = QueueConfig(max_frames=1 << 30)
"""A capture's queue is bounded in bytes only. A full queue stops the reading, which a server takes
for a slow link; a machine that draws slowly should get there as late as possible."""


def play(config: PlayConfig) -> PlaySummary:
    """Plays the stream to its end, or until the window is closed.

    The report is written on Ctrl-C too, of what was played by then.
    """
    with ExitStack() as stack:
        if config.capture is None:
            # Finds and loads the system's library for windows, which a capture does without.
            from player.show.glwindow import window_system

            stack.enter_context(window_system())
        relay = None
        if config.link is not None:
            relay = stack.enter_context(_relay(config.link, config.source))
        playback = _Playback(config, relay)
        stack.callback(playback.close)
        try:
            playback.run()
        except KeyboardInterrupt:
            playback.write(interrupted=True)
            raise
        return playback.write(interrupted=False)


def _relay(link: Link, url: str) -> LinkProcess:
    """A relay to the host of `url`."""
    parts = check_url(url)
    return LinkProcess(link, parts.hostname or "", parts.port or 80)


class _Playback:
    """The plays of one command, one after another on one clock."""

    def __init__(self, config: PlayConfig, relay: LinkProcess | None) -> None:
        self._config = config
        self._kind = config.renderer
        self._relay = relay
        self._time = DeviceTime()
        self._clock = Clock(real=True, time_s=self._time.time_s)
        self._smoothing = Smoothing(config.interpolate)
        self._renderers: list[Renderer] = []
        self._journal = Journal(MAX_ROWS if config.report or config.plot else 0)
        self._summary = PlaySummary(config.name, link=config.link, journal=self._journal)
        via = relay.address if relay is not None else None
        self._opener = Opener(
            config.source, via, self._received, config.delivery, config.max_gaussians
        )

    def close(self) -> None:
        self._opener.close()

    def run(self) -> None:
        if self._config.capture is not None:
            self._capture()
        else:
            self._show_window()

    def write(self, interrupted: bool) -> PlaySummary:
        """The summary, which is written to where it is asked for."""
        summary, config = self._summary, self._config
        summary.interrupted = interrupted
        if self._renderers:
            summary.renderer = self._renderers[-1].name
        summary.uploaded_bytes = sum(one.uploaded_bytes for one in self._renderers)
        if self._relay is not None:
            summary.link_bytes = self._relay.down_bytes
            summary.link_began_s = self._relay.began_s
        if config.report is not None:
            write_report(config.report, summary)
        if config.plot is not None:
            from player.report.plots import write_plot  # matplotlib loads slowly

            write_plot(config.plot, summary.to_json())
        return summary

    def _note(self, record: FrameRecord, drawn: bool) -> None:
        self._journal.shown(record, self._clock.now_s() if drawn else None)

    def _open(self, first_frame: int) -> Source:
        """Asks for the stream from a frame on."""
        config = self._config
        # Files have time to wait for all that there is, unless the link is asked to decide.
        adaptive = config.capture is None or config.link is not None
        frames = FrameRange(first_frame, config.frames.end)
        return self._opener.open(frames, config.layers, adaptive)

    def _open_whole(self, first_frame: int) -> Source:
        """The same with all layers, however slowly they come."""
        return self._opener.open(FrameRange(first_frame, self._config.frames.end), None)

    def _events(self, source: Source, play: int, not_before_s: float) -> Events:
        """The queue of a play."""
        config, summary, clock = self._config, self._summary, self._clock
        playout = _playout(config, source, play, not_before_s)
        summary.source, summary.fps = source.name, source.manifest.fps
        if config.capture is not None:
            self._smoothing.pictures_hz = config.fps or source.manifest.fps
        summary.add_play(PlayedOnce(max(not_before_s, clock.now_s()), playout.totals))
        return Events(playout, clock, partial(self._journal.arrived, play), self._smoothing)

    def _rehearse(self, kind: RendererKind) -> None:
        """Makes ready what draws the plays of a network."""
        if is_url(self._config.source):
            began_s = time.monotonic()
            self._kind = rehearse(kind, self._config.gl)
            self._summary.preparing_s = time.monotonic() - began_s

    def _rehearse_for_window(self) -> None:
        try:
            self._rehearse(RendererKind.GL)
        except GlError:  # a window brings its own OpenGL
            self._rehearse(RendererKind.CPU)

    def _load_preview(self) -> Preview:
        found = self._opener.preview()
        if found is None:
            # Without a manifest, opening the stream says what is wrong.
            with closing(self._open(self._config.frames.first)) as source:
                found = Preview(source.manifest, None)
        return found

    def _show_window(self) -> None:
        """Plays in a window until that is closed."""
        from player.show.glwindow import GlWindow
        from player.show.window import PosterScreen, read_picture

        config, found = self._config, self._load_preview()
        camera = config.camera.of(found.manifest, config.size, FrameRange())(config.frames.first)
        size = Size(camera.width_px, camera.height_px)
        window = GlWindow(size, config.name, config.gl)
        poster = PosterScreen(window, read_picture(found.poster), config.window_background)
        preparing = BackgroundTask(self._rehearse_for_window)
        if poster.show_until(preparing.is_done):
            self._play_in(window, poster, size)

    def _play_in(self, window: GlWindow, poster: PosterScreen, size: Size) -> None:
        from player.show.captionchoice import CaptionChoice
        from player.show.window import show_window

        config = self._config
        self._clock.set_rate(config.rate)
        plays = math.inf if config.loop is None else config.loop
        conductor = Conductor(
            self._open,
            self._events,
            self._clock,
            config.frames.first,
            plays,
            self._opener.interrupt,
            None if config.layers is not None else self._open_whole,
            self._smoothing,
        )
        try:
            with conductor:
                source = conductor.source
                path = config.camera.of(source.manifest, size, source.frames)
                language = None if config.captions == NO_CAPTIONS else config.captions
                captions = CaptionChoice(
                    source.manifest.captions, self._opener.read_captions, language
                )
                with self._sounding(conductor, path(source.frames.first)) as sound:
                    show_window(
                        window,
                        poster,
                        conductor,
                        path,
                        self._renderers,
                        self._note,
                        config.window_background,
                        captions=captions,
                        sound=sound,
                    )
        finally:
            self._summary.received_bytes += conductor.received_bytes

    @contextmanager
    def _sounding(self, conductor: Conductor, camera: Camera) -> Iterator[SoundPlayer | None]:
        """The sound player while the `with` block runs; None if muted, or if the stream has no
        sound."""
        if self._config.mute or not conductor.source.manifest.sound:
            yield None
            return
        from .soundplay import sounding

        self._summary.sound = counts = SoundCounts()
        files, volume = self._opener.sound_files, self._config.volume
        with sounding(conductor, self._time, camera, files, counts, volume) as sound:
            yield sound

    def _received(self, num_bytes: int) -> None:
        self._journal.received(num_bytes, self._clock.now_s(), time.monotonic())

    @contextmanager
    def _join(self) -> Iterator[Joined]:
        """Asks for the stream, to capture it."""
        config, summary, clock = self._config, self._summary, self._clock
        with closing(self._open(config.frames.first)) as source:
            path = config.camera.of(source.manifest, config.size, source.frames)
            # What a server chooses for a frame is known when the frame is due, and not before.
            clock.real = source.adaptive
            events = self._events(source, summary.num_plays, 0.0)
            try:
                yield Joined(source, events, path)
            finally:
                summary.received_bytes += source.received_bytes

    def _capture(self) -> None:
        """Draws every frame into files."""
        from player.show.sink import open_sink  # the library for videos loads slowly

        self._rehearse(self._kind)
        output, loop = self._config.capture, self._config.loop
        assert output is not None
        assert loop is not None
        with ExitStack() as stack:
            files: _Files | None = None
            frames = 0
            for _ in range(loop):
                with (
                    self._join() as joined,
                    Threads(joined.source, joined.events) as threads,
                    closing(self._create_renderer(joined)) as renderer,
                ):
                    self._renderers.append(renderer)
                    if files is None:
                        source, first = joined.source, joined.path(joined.source.frames.first)
                        size = Size(first.width_px, first.height_px)
                        track = self._sound_track(stack, source)
                        smoothing, stream_fps = self._smoothing, source.manifest.fps
                        fps = smoothing.pictures_hz
                        times = OutputTimes(stream_fps, fps, smoothing.shows_between(stream_fps))
                        sink = stack.enter_context(
                            open_sink(output, fps, size, sound=track is not None)
                        )
                        count = source.frames.count
                        total = None if count is None else times.count(count * loop)
                        drawn = stack.enter_context(counted("drawing"))
                        files = _Files(sink, source.frames.first, total, drawn, track)
                    show = partial(self._show, files, joined.path)
                    frames += render_thread(
                        threads.update(renderer), renderer, joined.path, times, frames, show
                    )

    def _create_renderer(self, joined: Joined) -> Renderer:
        renderer = create_renderer(self._kind, joined.source.manifest, self._config.gl)
        renderer.alpha = self._config.background != BLACK
        return renderer

    def _sound_track(self, stack: ExitStack, source: Source) -> SoundTrack | None:
        """The sound of the capture, if the stream has any and there is a track for it."""
        config, manifest = self._config, source.manifest
        output = config.capture
        if config.mute or not manifest.sound or output is None:
            return None
        if output.suffix.lower() != VIDEO_SUFFIX:
            return None
        from player.sound.soundtrack import SoundTrack  # its decoder loads slowly

        files = stack.enter_context(closing(self._opener.sound_files()))
        return SoundTrack(manifest, files.read, source.num_frames, config.volume)

    def _show(
        self,
        files: _Files,
        path: CameraPath,
        record: FrameRecord | None,
        pictures: Iterator[Floats],
    ) -> None:
        shows = False
        for picture in pictures:
            if picture.shape[2] == 4:
                picture = on_background(picture, self._config.background)
            files.write(picture)
            shows = True
        if record is not None:
            files.write_sound(record.frame, path)
            self._note(record, drawn=shows)


class _Files:
    """Where the pictures of all plays go, one after another."""

    def __init__(
        self,
        sink: FrameSink,
        first_number: int,
        total: int | None,
        drawn: Counter,
        track: SoundTrack | None,
    ) -> None:
        self._sink, self._first_number, self._track = sink, first_number, track
        self._total, self._drawn = total, drawn
        self._written = 0

    def write(self, picture: Floats) -> None:
        self._sink.write(self._first_number + self._written, to_bytes(picture))
        self._written += 1
        self._drawn(self._written, self._total)

    def write_sound(self, frame: int, path: CameraPath) -> None:
        """Writes the sound of `frame` to the sink; call it once for each frame."""
        if self._track is not None:
            self._sink.write_sound(self._track.piece(frame, path(frame), path(frame + 1)))


def _playout(config: PlayConfig, source: Source, play: int, not_before_s: float) -> Playout:
    windowed = config.capture is None
    # A player with a fixed number of layers waits for all of them.
    needed = 1 if source.adaptive else source.num_layers
    return Playout(
        source.manifest,
        source.frames.first,
        source.frames.end,
        QueueConfig() if windowed else CAPTURE_QUEUE,
        WINDOW_PLAYOUT if windowed else None,
        needed,
        not_before_s=not_before_s,
        play=play,
    )

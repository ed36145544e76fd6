"""The sound of a window: its device, the thread that fetches it, and its counters."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from codec.camera import Camera
from codec.errors import CodecError
from player.playout.clock import DeviceTime
from player.playout.conductor import Conductor
from player.report.journal import SoundCounts
from player.source.soundfiles import SoundFiles

if TYPE_CHECKING:
    from player.sound.feed import SoundFeed, Whereabouts
    from player.sound.soundplayer import SoundPlayer

log = logging.getLogger(__name__)


@contextmanager
def sounding(
    conductor: Conductor,
    time: DeviceTime,
    camera: Camera,
    open_files: Callable[[], SoundFiles],
    counts: SoundCounts,
    volume: float = 1.0,
    backends: list[Any] | None = None,
) -> Iterator[SoundPlayer | None]:
    """Plays the sound of what `conductor` plays while the `with` block runs; gives None where the
    stream has none, or this machine cannot play it, which is logged.

    camera: where the listener is until the player's `camera` is set. counts: is filled at the end.
    backends: see `SoundDevice`.
    """
    manifest = conductor.source.manifest
    if not manifest.sound:
        yield None
        return
    try:
        # Only here: the libraries for sound load slowly, and may find no system's own.
        from miniaudio import MiniaudioError

        from player.sound.feed import DecodedSound, SoundFeed
        from player.sound.soundplayer import SoundDevice, SoundPlayer
    except (ImportError, OSError) as error:
        log.warning("playing without sound: %s", error)
        yield None
        return
    decoded, files = DecodedSound(manifest), open_files()
    with ExitStack() as playing:
        playing.callback(files.close)
        player: SoundPlayer | None = None
        try:
            feed = SoundFeed(manifest, files, decoded, lambda: _whereabouts(conductor))
            player = SoundPlayer(decoded, manifest.fps, time, conductor.media_at, camera, volume)
            device = SoundDevice(player, backends)
            playing.callback(_count, counts, files, feed, player)
            playing.enter_context(feed)
            playing.enter_context(device)
        except (MiniaudioError, CodecError) as error:
            player = None
            playing.close()
            reason = error.args[0] if isinstance(error, MiniaudioError) else error
            log.warning("playing without sound: %s", reason)
        yield player


def _count(counts: SoundCounts, files: SoundFiles, feed: SoundFeed, player: SoundPlayer) -> None:
    counts.received_bytes += files.received_bytes
    counts.segments += feed.loaded
    counts.failed_segments += len(feed.failed)
    counts.missing_s += player.missing_s


def _whereabouts(conductor: Conductor) -> Whereabouts:
    from player.sound.feed import Whereabouts

    state = conductor.state()
    return Whereabouts(state.frame, state.first_frame, state.end_frame, state.loops, state.rate)

"""The interface of a source of packets: a folder, a server, or a static host.

Every source gives a manifest at once, and then packets of slices and keyframes, each once: in
whatever layers and order they come, layer 0 in order of birth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from codec.errors import CodecError, InvalidError
from codec.framerange import FrameRange
from codec.stream.manifest import Manifest, Part
from server.abr.clientstatus import PLAY_HEADER, RATE_HEADER, ClientStatus
from server.abr.holding import Holding

Blame = Callable[[CodecError, Part], CodecError]
"""Makes an error name where the packet of a part came from."""


@dataclass(frozen=True, slots=True)
class SlicePackets:
    """Packets of one slice, as they came."""

    birth: int
    first_layer: int
    packets: tuple[bytes, ...]
    """One packet for each of the layers first_layer, first_layer + 1, ..."""
    skip_map: bytes | None
    """The packet of its skip map, beside that of layer 0; None without it."""
    blame: Blame

    @property
    def wire_bytes(self) -> int:
        """Bytes on the wire or on disk."""
        return sum(map(len, self.packets)) + len(self.skip_map or b"")

    @property
    def end_layer(self) -> int:
        return self.first_layer + len(self.packets)

    @property
    def first_frame(self) -> int:
        """The first frame that they can show in."""
        return self.birth

    def add_to(self, holding: Holding) -> None:
        """Notes in `holding` that they are there."""
        holding.add(self.birth, self.first_layer, self.end_layer)


@dataclass(frozen=True, slots=True)
class KeyframePackets:
    """Keyframes of some layers at the first frame of a segment."""

    frame: int
    first_layer: int
    packets: tuple[bytes, ...]
    """One packet for each of the layers first_layer, first_layer + 1, ..."""
    blame: Blame

    @property
    def wire_bytes(self) -> int:
        """Bytes on the wire or on disk."""
        return sum(map(len, self.packets))

    @property
    def end_layer(self) -> int:
        return self.first_layer + len(self.packets)

    @property
    def first_frame(self) -> int:
        """The first frame that they can show in."""
        return self.frame

    def add_to(self, holding: Holding) -> None:
        """Notes in `holding` that they are there."""
        holding.add_keyframes(self.frame, self.first_layer, self.end_layer)


Packets = SlicePackets | KeyframePackets


@dataclass(frozen=True, slots=True)
class LastPlay:
    """Name and link rate of a play, to be sent with the request of the next one."""

    token: str = ""
    """The server's name of the play; empty without one."""
    rate_bps: float | None = None
    """The server's last estimate of the link, bits per second: a server that does not know the
    play, as it was started again since, uses it."""

    def headers(self) -> dict[str, str]:
        """For the request of the next play."""
        headers = {PLAY_HEADER: self.token} if self.token else {}
        if self.rate_bps is not None:
            headers[RATE_HEADER] = str(round(self.rate_bps))
        return headers


NO_PLAY = LastPlay()

REPORT_S = 1.0
"""The longest time between two status reports, where the server asks for no other, seconds."""


class Source(Protocol):
    """A stream from one frame on. One thread iterates; `send_status` and `interrupt` may come from
    others.

    A source gives these properties as plain attributes where they do not change.
    """

    @property
    def name(self) -> str:
        """Where the stream is, as the user named it."""
        ...

    @property
    def manifest(self) -> Manifest: ...

    @property
    def frames(self) -> FrameRange:
        """The frames that will come; their end is None while it is not known."""
        ...

    @property
    def num_frames(self) -> int:
        """How many frames the stream is known to have by now."""
        ...

    @property
    def adaptive(self) -> bool:
        """Whether what comes depends on how fast it comes: layers are chosen on the way."""
        ...

    @property
    def num_layers(self) -> int:
        """The most layers that come."""
        ...

    @property
    def play(self) -> LastPlay:
        """The server's name and link rate of this play; empty without any."""
        ...

    @property
    def received_bytes(self) -> int:
        """Bytes read so far, everything included."""
        ...

    def packets(self) -> Iterator[Packets]:
        """All that shows in `frames`, and nothing else."""
        ...

    @property
    def report_s(self) -> float:
        """The longest time between two status reports, seconds."""
        ...

    def send_status(self, status: ClientStatus) -> bool:
        """Sends the state of the playback to the server, from another thread; gives whether it
        listens. May wait for the network."""
        ...

    def interrupt(self) -> None:
        """Makes a thread that waits for packets raise StoppedError soon."""
        ...

    def close(self) -> None: ...


def check_layers(layers: int | None, manifest: Manifest, name: str) -> int:
    """How many layers to take when `layers` are asked for; None takes all. Raises InvalidError."""
    if layers is None:
        return manifest.num_layers
    if not 1 <= layers <= manifest.num_layers:
        raise InvalidError(
            f"{name} has {manifest.num_layers} layers; --layers {layers} is not in this range"
        )
    return layers


def check_frames(frames: FrameRange, manifest: Manifest, num_frames: int, name: str) -> FrameRange:
    """`frames` with the end that they will have. Raises InvalidError when the stream lacks them."""
    beyond = frames.first if frames.end is None else frames.end - 1
    # A live stream may be joined before its first segment stands.
    if frames.first >= (num_frames or int(manifest.live)) or (
        beyond >= num_frames and not manifest.live
    ):
        raise InvalidError(f"{name} has {num_frames} frames; there is no frame {beyond}")
    if frames.end is not None or manifest.live:
        return frames
    return FrameRange(frames.first, num_frames)

"""What a response that is made while it is sent is written with."""

from __future__ import annotations

from typing import Protocol

from .tcpinfo import TcpInfo


class BodyWriter(Protocol):
    """Sends a body to one client, and tells how the client gets on.

    When the client goes away, the task that writes is cancelled.
    """

    @property
    def cut(self) -> str:
        """Why the connection is over: "gone", "stalled" or "stopped"; empty while it is not."""
        ...

    def hold_at_most(self, queue_bytes: int) -> None:
        """Lets about `queue_bytes` wait unsent in the process, and as many in the kernel."""
        ...

    def queued_bytes(self) -> int:
        """Bytes written but not yet acknowledged by the client's side, as far as one can see."""
        ...

    def tcp_info(self) -> TcpInfo | None:
        """What the kernel knows of the connection; None where it does not tell."""
        ...

    async def write(self, data: bytes) -> None:
        """Writes `data`, and waits until there is room for more."""
        ...

"""The Gaussians that the steps of a window render, as the resident holds them."""

from __future__ import annotations

from trainer.step.backend import Resident, Selection

from .generations import Generations


class Selections:
    """Made when first asked for, and kept until `forget`: a step then sends no rows.

    There are at most swin_size frames times the layers of them.
    """

    def __init__(self, resident: Resident, generations: Generations) -> None:
        self._resident, self._generations = resident, generations
        self._held: dict[tuple[int, int | None], Selection] = {}

    def forget(self) -> None:
        """To be called when a lifespan, a layer or what follows another training has changed."""
        self._held.clear()

    def at(self, frame: int, layers: int | None = None) -> Selection:
        """Everything that shows at `frame`; of the first `layers` layers, if that is given."""
        if (frame, layers) not in self._held:
            self._held[frame, layers] = self._made(frame, layers)
        return self._held[frame, layers]

    def _made(self, frame: int, layers: int | None) -> Selection:
        generations = self._generations
        rows = generations.lifespans.active_rows(frame)
        if layers is not None:
            assert generations.leases is not None
            rows = rows[generations.leases.layers[rows % generations.num_gs] < layers]
        trained = rows[rows < generations.num_gs]
        if generations.takeover is not None:
            trained = trained[~generations.takeover.follows[trained]]
        return self._resident.select(rows, trained)

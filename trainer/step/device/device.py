"""Steps on a device of torch, around a rasteriser that is given."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from trainer.step.backend import MemoryNeeds, Resident, StepInput, Training
from trainer.step.loss import Loss
from trainer.step.raster import Parameters

from .crossing import Crossing
from .devicememory import free_bytes, planned
from .deviceresident import DeviceResident
from .deviceview import DeviceView
from .packedrows import pack, unpack
from .picturecache import DEFAULT_PICTURE_BYTES, DeviceShot
from .tensorloss import Rasterise, TensorLoss


class DeviceBackend:
    """A rasteriser on a device of torch, and all that surrounds it."""

    def __init__(
        self,
        dssim_weight: float,
        opacity_reg: float,
        scale_reg: float,
        rasterise: Rasterise,
        device: str,
        batch_bytes: int = 0,
        picture_bytes: int = DEFAULT_PICTURE_BYTES,
    ) -> None:
        """device: of torch; batch_bytes: what the rasteriser takes beside pixels and pairs;
        picture_bytes: of the captured pictures that it keeps at most."""
        # In TF32 the variances of SSIM would be differences of rounded numbers.
        torch.backends.cudnn.allow_tf32 = False
        self.crossing = Crossing(torch.device(device))
        """Counts what this backend sends and receives."""
        self.loss = TensorLoss(dssim_weight, opacity_reg, scale_reg, rasterise, self.crossing)
        self._batch_bytes = batch_bytes
        self._picture_bytes = self._max_picture_bytes = picture_bytes

    def plan(self, needs: MemoryNeeds) -> str | None:
        """See `Backend.plan`."""
        device = self.crossing.device
        free, where = free_bytes(device), f"device {device}"
        plan = planned(needs, free, self._batch_bytes, self._max_picture_bytes, where)
        self._picture_bytes = plan.pictures_bytes
        return f"memory: {plan} of {free / 1e9:.1f} GB that are free on {where}"

    def start(self, training: Training) -> Resident:
        """See `Backend.start`."""
        return DeviceResident(training, self.loss, self.crossing, self._picture_bytes)

    def step(self, given: StepInput, gradients: Parameters) -> Loss:
        """See `Backend.step`; computes all of the picture in any case. For trials: a training has
        a resident."""
        crossing, rows, shot = self.crossing, given.rows, given.shot
        leaf = crossing.send(pack(given.values, rows)).requires_grad_()
        correction = crossing.send(np.concatenate([given.gain, given.bias])).requires_grad_()
        mask = None if shot.mask is None else crossing.send_picture(shot.mask) > 0
        sent = DeviceShot(crossing.send_picture(shot.picture), None)
        target, _ = sent.planes(shot.is_half)
        view = DeviceView.send(given.view, crossing)
        compared = self.loss.compare(leaf, view, target, mask, correction, len(leaf), whole=True)
        compared.picture.retain_grad()
        compared.total.backward()  # type: ignore[no-untyped-call]
        found = Parameters.zeros_like(given.values, len(rows))
        unpack(self._received(leaf), found)
        mine = rows < given.trainable
        for gradient, array in zip(gradients.arrays, found.arrays, strict=True):
            gradient[rows[mine]] = array[mine]
        by_correction = self._received(correction)
        return Loss(
            float(crossing.receive(compared.photometric)),
            self._received(compared.picture),
            by_correction[:3],
            by_correction[3:],
        )

    def _received(self, leaf: Tensor) -> np.ndarray:
        """The gradient of `leaf` in host memory; zeros where it had no part."""
        return self.crossing.receive(torch.zeros_like(leaf) if leaf.grad is None else leaf.grad)

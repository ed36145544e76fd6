"""The backends of torch, gsplat and plain torch, give the CPU's losses and gradients.

Without a GPU, a slow rasteriser with the same argument names replaces gsplat's. Then all of our own
code is checked: colours, loss, regularisers and the path of the gradients.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from codec.camera import Camera
from codec.splats import SH_C0
from player.render.project import LOW_PASS_PX2, TILE_PX
from tests.support.reference_render import render_reference
from tests.trainer.step.device.test_torchraster import WEIGHTS, shot_of, stepped
from trainer.step.backend import Backend
from trainer.step.cpubackend import CpuBackend
from trainer.step.device.backends import CudaBackend, TorchBackend
from trainer.step.raster import Parameters

COUNT, TRAINABLE = 60, 45
CAMERA = Camera("c", 48, 40, 45.0, 47.0, 23.0, 21.0, np.eye(4))


def stand_in(**given: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """The result of gsplat.rasterization for one camera, from the plain reference."""
    assert (given["eps2d"], given["tile_size"]) == (LOW_PASS_PX2, TILE_PX)
    assert (given["rasterize_mode"], given["packed"]) == ("classic", False)
    k = given["Ks"][0].double().numpy()
    camera = Camera(
        "given", given["width"], given["height"], k[0, 0], k[1, 1], k[0, 2], k[1, 2],
        given["viewmats"][0].double().numpy(),
    )  # fmt: skip
    picture = render_reference(
        given["means"], given["scales"].log(), given["quats"], torch.logit(given["opacities"]),
        ((given["colors"] - 0.5) / SH_C0)[:, None], camera, given["near_plane"],
    )  # fmt: skip
    return picture[None], torch.ones(1), {}


def small_scene(sh_degree: int) -> Parameters:
    rng = np.random.default_rng(2)
    values = Parameters.zeros(COUNT, sh_degree)
    values.means[:] = rng.uniform((-1, -1, 2), (1, 1, 4), (COUNT, 3))
    values.log_scales[:] = rng.uniform(-3, -1.2, (COUNT, 3))
    values.quats[:] = rng.normal(size=(COUNT, 4))
    # No opacity at which the maximum alphas of the two rasterisers differ.
    values.logit_opacities[:] = rng.uniform(-3, 2, COUNT)
    values.sh[:] = rng.uniform(-0.4, 1.2, values.sh.shape)
    return values


def backend_named(name: str) -> Backend:
    """The backend `name`; skips the test if it cannot run."""
    if name == "stand-in":
        return CudaBackend(*WEIGHTS, stand_in, "cpu")
    if name == "torch":
        return TorchBackend(*WEIGHTS, "cpu")
    if not torch.cuda.is_available():
        pytest.skip("needs an NVIDIA GPU")
    if name == "torch on a GPU":
        return TorchBackend(*WEIGHTS, "cuda")
    return CudaBackend(*WEIGHTS, pytest.importorskip("gsplat").rasterization)


@pytest.mark.parametrize(
    ("sh_degree", "masked"), [(0, False), (1, False), (2, False), (3, False), (0, True)]
)
@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("name", ["stand-in", "torch", "gsplat", "torch on a GPU"])
def test_steps_give_cpu_s_gradients(name: str, half: bool, sh_degree: int, masked: bool) -> None:
    backend = backend_named(name)
    shot = shot_of(CAMERA, 3, masked, half)
    rows = np.random.default_rng(4).permutation(COUNT)[: COUNT - 5].astype(np.int32)
    given = small_scene(sh_degree), CAMERA, rows, TRAINABLE, shot
    wanted, expected = stepped(CpuBackend(*WEIGHTS), *given)
    # It always computes the whole picture.
    found, got = stepped(backend, *given, whole=False)
    assert found.covered == 1
    assert found.value == pytest.approx(wanted.value, rel=1e-4)
    for a, b in ((found.gain_grad, wanted.gain_grad), (found.bias_grad, wanted.bias_grad)):
        assert a is not None
        assert b is not None
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-6)
    # Plain torch has the recipe's maximum alpha, too, and differs only by rounding.
    rtol, share = (1e-3, 1e-4) if isinstance(backend, TorchBackend) else (2e-2, 2e-3)
    for a, b in zip(got.arrays, expected.arrays, strict=True):
        trained = rows[rows < TRAINABLE]
        assert np.abs(b[trained]).max() > 0
        assert (np.delete(a, trained, axis=0) == 7).all()  # frozen rows get none
        largest = np.abs(b[trained]).max()
        np.testing.assert_allclose(a[trained], b[trained], rtol=rtol, atol=share * largest)

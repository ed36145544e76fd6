"""The settings of the sliding-window training."""

from __future__ import annotations

from dataclasses import dataclass, field

from codec.errors import InvalidError
from codec.slice import MAX_SWIN_SIZE
from trainer.lease.leases import LeaseConfig
from trainer.step.backend import BackendName
from trainer.step.device.pick import Picked, Weights, pick_backend

from .mcmc import McmcConfig
from .optimiser import OptimiserConfig


@dataclass(frozen=True)
class FitConfig:
    """What the sliding-window training does; times are frames, sizes Gaussians."""

    num_gs: int = 20_000
    """Gaussians active in a frame. Paper: 200,000 on a GPU; 20,000 suits two CPU cores."""
    swin_size: int = 1
    """Frames that a lease lasts, or a Gaussian that is sent whole lives. Leases want 1, for then
    what moves can follow every frame; what is sent whole wants more. Paper, section 8.1: 5."""
    sh_degree: int = 0
    """Degree of the colour's spherical harmonics, 0 or 1. The paper trains 1 and streams 0."""
    genesis_iterations: int = 3_000
    """Iterations of the first window, before it settles; 0 where its Gaussians are given. Paper:
    30,000 on a GPU."""
    coarse_share: float = 0.6
    """Share of genesis, from its beginning, that sees pictures of half the size, so that shapes
    settle where the cameras agree before detail is learned by heart; 0 switches it off."""
    settle_rounds: int = 20
    """How often the first window is trained once more after genesis, each time like a later window:
    renewed first, and with learning rates that begin high again."""
    settle_renew_share: float = 0.1
    """Share of the Gaussians, those that contribute least, that each such round renews."""
    window_iterations: int = 400
    """Iterations of every later window. Paper: 2,000 on a GPU."""
    newest_share: float = 0.5
    """Share of a window's iterations that is spent on its newest frame, where no earlier window has
    seen it."""
    error_share: float = 0.5
    """Share of a later window's iterations that goes to cameras by how much is wrong where they see
    what is trained; the rest is for all alike. Only where slots are leased."""
    dssim_weight: float = 0.2
    """Weight of 1 - SSIM beside L1. 3DGS."""
    colour_lr: float = 1e-3
    """Learning rate of the per-camera colour correction; 0 switches it off."""
    calm_from: float = 0.7
    """Share of a window's iterations after which all learning rates but the positions' fall, too;
    1 leaves them as they are."""
    calm_end: float = 0.1
    """What they have fallen to at the end of a window, as a share."""
    together_share: float = 0.1
    """Share of a window's iterations in which all Gaussians of a large cell move together, and
    again the same share for smaller cells. Only where slots are leased."""
    settle_prefix_share: float = 0.25
    """Share of the iterations in which genesis settles that render only the first layers, so that
    these do without the others. Only where slots are leased."""
    prefix_share: float = 0.1
    """The same of later windows."""
    seed: int = 0
    """Seed of every random choice."""
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    """Learning rates."""
    mcmc: McmcConfig = field(default_factory=McmcConfig)
    """Relocation, noise, regularisers."""
    lease: LeaseConfig = field(default_factory=LeaseConfig)
    """What is kept from slice to slice."""

    def __post_init__(self) -> None:
        if not 1 <= self.swin_size <= MAX_SWIN_SIZE:
            raise InvalidError(f"swin_size {self.swin_size}: choose 1 to {MAX_SWIN_SIZE}")
        if self.seed < 0:
            raise InvalidError(f"seed {self.seed}: choose 0 or more")
        if self.num_gs < self.swin_size or self.num_gs % self.swin_size:
            raise InvalidError(
                f"num_gs {self.num_gs} is not a multiple of swin_size {self.swin_size}"
            )
        if self.sh_degree not in (0, 1):
            raise InvalidError(f"sh_degree {self.sh_degree}: choose 0 or 1")
        if self.settle_rounds < 0:
            raise InvalidError(f"settle_rounds {self.settle_rounds}: choose 0 or more")
        if self.genesis_iterations < 0 or self.window_iterations < 1:
            raise InvalidError("genesis_iterations below 0, or window_iterations below 1")
        if not self.genesis_iterations and not self.settle_rounds:
            raise InvalidError("genesis_iterations 0 and settle_rounds 0 leave nothing to train")
        for name in (
            "coarse_share",
            "newest_share",
            "dssim_weight",
            "calm_from",
            "error_share",
            "prefix_share",
            "settle_renew_share",
            "settle_prefix_share",
        ):
            if not 0 <= getattr(self, name) <= 1:
                raise InvalidError(f"{name} {getattr(self, name):g}: choose 0 to 1")

    def iterations(self, first_frame: int) -> int:
        """Of the window that begins with `first_frame`."""
        if first_frame:
            return self.window_iterations
        return self.genesis_iterations + self.settle_rounds * self.window_iterations

    def backend(self, name: BackendName, device: str | None = None) -> Picked:
        """The backend `name` for this loss; device: of backend torch. Raises InvalidError where it
        cannot run."""
        weights = Weights(self.dssim_weight, self.mcmc.opacity_reg, self.mcmc.scale_reg)
        return pick_backend(name, weights, device)

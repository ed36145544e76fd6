"""Colour: every channel of every colour times a gain, which is what exposure and white balance are.

Colours are encoded for displays by about a power law, so a factor of the light is a factor of the
encoded value, too. Gaussians blend linearly: each pixel, too, is multiplied by the gain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import tyro

from codec.errors import InvalidError
from codec.lattice.lattice import COLOURS, Flags, Lattice, States
from codec.lattice.quantise import to_luma
from codec.pose import Doubles
from codec.splats import SH_C0, Splats
from codec.stream.manifest import Manifest

from .edit import HOLD, Edit

DISPLAY_GAMMA = 2.2
"""Exponent from an encoded colour to light."""

SPREAD = 1.05
"""Factor of the steps of the colours, beside the gain. With exactly the gain, one gain for all
channels would add the same fraction of a step to every colour, and all would be off to the same
side."""

Rgb = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ColourOptions:
    """Gains of the colours; all that are given are multiplied."""

    exposure: float = 0.0
    """Stops of light: 1 doubles it."""
    white: Annotated[Rgb | None, tyro.conf.arg(metavar="R G B")] = None
    """A colour of the scene, 0 to 1 in each channel, that is to become grey of the same
    brightness."""
    gain: Annotated[Rgb, tyro.conf.arg(metavar="R G B")] = (1.0, 1.0, 1.0)
    """Factor of each channel of the encoded colours."""

    def gains(self) -> Doubles:
        """(3,) the factor of each channel. Raises InvalidError."""
        gains = np.array(self.gain) * 2 ** (self.exposure / DISPLAY_GAMMA)
        if self.white is not None:
            white = np.array(self.white)
            if not (np.isfinite(white).all() and (white > 0).all()):
                raise InvalidError("white: each channel must be above 0")
            gains = gains * float(to_luma(white)[0]) / white
        if not (np.isfinite(gains).all() and (gains > 0).all()):
            raise InvalidError("colour: each gain must be above 0 and finite")
        return gains


class Colour(Edit):
    """Multiplies each colour channel by its gain."""

    keeps_pictures = False
    rounds = True

    def __init__(self, options: ColourOptions, source: Manifest, coarseness: float = 1.0) -> None:
        """Raises InvalidError for gains that leave the bounds of a lattice."""
        self.gains = options.gains()
        self._options, self._manifest, self._coarseness = options, source, coarseness
        self._source = source.lattice
        try:
            self._lattices = tuple(map(self._scaled, source.lattice))
        except InvalidError as error:
            raise InvalidError(f"colour: {error}") from error

    def coarser(self, factor: float) -> Colour:
        return Colour(self._options, self._manifest, factor)

    def manifest(self, source: Manifest) -> Manifest:
        """The result's manifest: `source` with other steps of the colours."""
        return replace(source, lattice=self._lattices)

    def states(self, layer: int, states: States, before: States | None) -> tuple[States, Flags]:
        numbers = states.numbers()
        given = numbers[:, 3 + COLOURS : -1]
        luma = given.reshape(-1, 3, given.shape[1] // 3) * self._source[layer].colour
        y, co, cg = luma.transpose(1, 0, 2)
        rgb = np.stack([y - cg + co, y + cg, y - cg - co], axis=-1)  # (N, K, 3)
        colours = to_luma(self._gained(rgb)).transpose(0, 2, 1) / self._lattices[layer].colour
        colours = colours.reshape(given.shape)
        made = np.rint(colours)
        if before is not None:
            held = before.numbers()[:, 3 + COLOURS : -1]
            made = np.where(np.abs(colours - held) <= HOLD, held, made)
        fits: Flags = (made.min(axis=1) >= -128) & (made.max(axis=1) <= 127)
        attributes = states.attributes.copy()
        attributes[:, COLOURS:-1] = np.clip(made, -128, 127).astype(np.int16).astype(np.uint8)
        return States(states.positions, attributes), fits

    def splats(self, splats: Splats) -> Splats:
        sh = self._gained(splats.sh.astype(np.float64)).astype(np.float32)
        return Splats(*splats.arrays[:4], sh)

    def _gained(self, rgb: Doubles) -> Doubles:
        """(N, K, 3) coefficients whose colour, 0.5 + ..., is that of `rgb` times the gains."""
        made: Doubles = rgb * self.gains
        made[:, 0] += (self.gains - 1) * 0.5 / SH_C0
        return made

    def _scaled(self, lattice: Lattice) -> Lattice:
        """`lattice` with steps of the colours that grow with them, so that they take no more bytes
        than before; where colours get darker, steps shrink less than they, for an error shows as
        much as before."""
        gain = float(self.gains.max())
        if (self.gains == 1).all():
            return lattice
        growth = max(gain, gain**0.5) * SPREAD * self._coarseness
        return replace(lattice, colour=lattice.colour * growth)

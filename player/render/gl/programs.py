"""Shaders: their text with the recipe's constants in front, and the camera in their uniforms."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files

import moderngl
import numpy as np
import numpy.typing as npt

from codec.camera import Camera

from .. import recipe
from ..pack import COLOUR_COLUMNS
from ..project import jacobian_limits

Constants = Mapping[str, int | float | str]

_RECIPE: Constants = {
    "SH_C1": recipe.SH_C1,
    **{f"SH_C2_{n}": value for n, value in enumerate(recipe.SH_C2)},
    **{f"SH_C3_{n}": value for n, value in enumerate(recipe.SH_C3)},
    "COLOUR_COLUMNS": COLOUR_COLUMNS,
    "LOW_PASS_PX2": recipe.LOW_PASS_PX2,
    "MAX_EXTENT_SIGMA": recipe.MAX_EXTENT_SIGMA,
    "ALPHA_MIN": recipe.ALPHA_MIN,
    "ALPHA_MAX": recipe.ALPHA_MAX,
}


def _head(version: int, constants: Constants) -> str:
    lines = [f"#define {name} {value}" for name, value in {**_RECIPE, **constants}.items()]
    return "\n".join([f"#version {version} core", *lines])


def _text(shader: str) -> str:
    return (files("player.render.gl") / "shaders" / shader).read_text(encoding="utf-8")


def compile_program(
    context: moderngl.Context, shader: str, constants: Constants | None = None, version: int = 330
) -> moderngl.Program:
    """The program of a file that holds both stages."""
    head, source = _head(version, constants or {}), _text(shader)
    return context.program(
        vertex_shader=f"{head}\n#define VERTEX_STAGE\n{source}",
        fragment_shader=f"{head}\n#define FRAGMENT_STAGE\n{source}",
    )


def compile_compute(
    context: moderngl.Context, shader: str, constants: Constants
) -> moderngl.ComputeShader:
    """The compute shader of a file; its `sync()` waits until all of a group see what each wrote."""
    sync = "void sync() { memoryBarrierShared(); barrier(); }"
    return context.compute_shader(f"{_head(430, constants)}\n{sync}\n{_text(shader)}")


class Quads:
    """One quad for each Gaussian that is to be drawn, in its colours or with its depth."""

    def __init__(
        self, context: moderngl.Context, constants: Constants, version: int, slots: moderngl.Buffer
    ) -> None:
        """slots: uint32, which Gaussians, farthest first."""
        self._context, self._constants, self._version = context, constants, version
        self._slots = slots
        self._colours = self._compiled({})
        self._depths: moderngl.VertexArray | None = None  # few ever ask

    def _compiled(self, more: Constants) -> moderngl.VertexArray:
        constants = {**self._constants, **more}
        program = compile_program(self._context, "splat.glsl", constants, self._version)
        if "colours" in program:  # harmonics of degree 2 and 3; depths do not look at them
            program["colours"] = 1
        return self._context.vertex_array(program, [(self._slots, "1u/i", "slot")])

    def seen(self, camera: Camera, depths: bool) -> moderngl.VertexArray:
        """The quads as `camera` sees them; what they blend is their depth, metres, or colours."""
        if depths and self._depths is None:
            self._depths = self._compiled({"DEPTH": 1})
        quads = self._depths if depths and self._depths is not None else self._colours
        set_camera(quads.program, camera)
        return quads


def set_camera(program: moderngl.Program | moderngl.ComputeShader, camera: Camera) -> None:
    """Fills those of the camera's uniforms that the program has."""
    values: dict[str, npt.ArrayLike] = {
        "rotation": camera.w2c[:3, :3].T,  # OpenGL stores columns
        "translation": camera.w2c[:3, 3],
        "position": camera.position,
        "focal_px": (camera.fx_px, camera.fy_px),
        "centre_px": (camera.cx_px, camera.cy_px),
        "limit": jacobian_limits(camera),
        "size_px": (camera.width_px, camera.height_px),
    }
    for name, value in values.items():
        uniform = program.get(name, None)
        # A compiler leaves out what it finds unused: `position` but for linear harmonics.
        if isinstance(uniform, moderngl.Uniform):
            uniform.write(np.ascontiguousarray(value, np.float32))

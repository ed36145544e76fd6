"""The house rules as tests: who may import whom, what stays pure, what ships."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import ROOT

HOUSE = ("codec", "trainer", "server", "player")

# Which of our packages each folder may import, besides itself; longest match of a prefix.
MAY_USE: dict[str, tuple[str, ...]] = {
    "codec": (),
    "trainer": ("codec", "player.render"),
    "server": ("codec",),
    "player": ("codec", "server.abr"),
    "server/abr": ("codec.errors", "codec.stream.manifest", "codec.stream.index"),
    "player/render": ("codec",),
}
NO_IO = {"asyncio", "aiohttp", "os", "pathlib", "socket", "threading", "time", "datetime", "random"}


def python_files(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def imported_modules(file: Path) -> set[str]:
    """Full names of all modules that `file` imports, relative ones resolved."""
    package = file.relative_to(ROOT).parent.parts
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            stem = ".".join(part for part in (base, node.module or "") if part)
            names.add(stem)
            names |= {f"{stem}.{alias.name}" for alias in node.names}
    return names


USES_TORCH = ("trainer/step/backend.py", "trainer/step/cuda.py")


def is_within(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


@pytest.mark.parametrize("folder", sorted(MAY_USE))
def test_imports_run_downhill(folder: str) -> None:
    own = folder.replace("/", ".")
    allowed = (own, *MAY_USE[folder])
    for file in python_files(folder):
        for module in imported_modules(file):
            if module.split(".")[0] in HOUSE:
                # `from codec import x` names both codec and codec.x
                ok = any(is_within(module, a) or is_within(a, module) for a in allowed)
                assert ok, f"{file.relative_to(ROOT)} imports {module}"


def test_only_the_gpu_backend_imports_torch() -> None:
    for folder in HOUSE:
        for file in python_files(folder):
            tops = {m.split(".")[0] for m in imported_modules(file)}
            may = file.relative_to(ROOT).as_posix() in USES_TORCH
            assert may or not tops & {"torch", "gsplat"}, file
    code = "import sys, trainer.__main__; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


def test_abr_is_pure() -> None:
    for file in python_files("server/abr"):
        tops = {m.split(".")[0] for m in imported_modules(file)}
        assert not tops & NO_IO, f"{file.relative_to(ROOT)} imports {tops & NO_IO}"


def test_there_is_no_circle_and_every_module_imports_alone() -> None:
    modules = [
        ".".join(f.relative_to(ROOT).with_suffix("").parts)
        for folder in ("codec", "server", "player", "trainer")
        for f in python_files(folder)
        if f.name not in ("__init__.py", "__main__.py")
    ]
    # One fresh interpreter; each module is loaded with none of ours in memory.
    code = (
        "import importlib, sys\n"
        f"for name in {modules!r}:\n"
        "    for loaded in [m for m in sys.modules if m.split('.')[0] in "
        f"{HOUSE!r}]:\n"
        "        del sys.modules[loaded]\n"
        "    importlib.import_module(name)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=240
    )
    assert done.returncode == 0, done.stderr[-2000:]


def test_no_catch_all_modules_and_no_god_files() -> None:
    for folder in HOUSE:
        for file in python_files(folder):
            assert file.stem not in {"utils", "util", "common", "helpers", "misc"}, file
            lines = len(file.read_text(encoding="utf-8").splitlines())
            limit = 80 if file.name == "__main__.py" else 500
            assert lines <= limit, f"{file.relative_to(ROOT)} has {lines} lines"


def test_no_test_folder_wears_a_package_name() -> None:
    # tests/codec/__init__.py would be imported as `codec` and hide the real one.
    assert not [name for name in HOUSE if (ROOT / "tests" / name / "__init__.py").exists()]


def test_what_git_would_ship_is_not_ignored() -> None:
    """hatchling leaves ignored files out of a wheel: shaders and FORMAT.md must not be."""
    assets = [*ROOT.glob("player/render/shaders/*"), ROOT / "codec" / "FORMAT.md"]
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    done = subprocess.run(
        ["git", "check-ignore", *map(str, assets)], cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout == ""

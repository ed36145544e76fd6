"""The rules of the code as tests: imports, purity, and the size and names of files."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from itertools import accumulate
from pathlib import Path

import pytest

from docs.architecture import PAGE, PICTURE, page, picture
from tests.importlaw import FLOORS, MAY_USE
from tests.importlaw import PACKAGES as HOUSE

ROOT = Path(__file__).parents[1]

NO_IO = {"asyncio", "aiohttp", "os", "pathlib", "socket", "threading", "time", "datetime", "random"}

PURE = (
    "server/abr",
    "server/study/generate.py",
    "server/study/policies.py",
    "server/study/qoe.py",
    "server/study/policies.py",
    "server/study/simulator.py",
)
"""The folders and files whose code does no I/O and reads no clock."""


def python_files(folder: str) -> list[Path]:
    # An npm package may have some of its own.
    return sorted(f for f in (ROOT / folder).rglob("*.py") if "node_modules" not in f.parts)


def house_files() -> list[Path]:
    return [file for folder in HOUSE for file in python_files(folder)]


def run_on_import(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes below `node` that run when its module is imported."""
    for child in ast.iter_child_nodes(node):
        for_types = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)
        if not for_types and not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield child
            yield from run_on_import(child)


@cache
def imported_modules(file: Path, on_import: bool = False) -> set[str]:
    """Full names of all modules that `file` imports, with relative ones resolved. on_import: only
    those that importing it imports."""
    package = file.relative_to(ROOT).parent.parts
    names: set[str] = set()
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in run_on_import(tree) if on_import else ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            stem = ".".join(part for part in (base, node.module or "") if part)
            names.add(stem)
            names |= {f"{stem}.{alias.name}" for alias in node.names}
    return names


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


@pytest.mark.parametrize("folder", sorted(MAY_USE))
def test_no_import_is_allowed_that_is_not_there(folder: str) -> None:
    used = {module for file in python_files(folder) for module in imported_modules(file)}
    for allowed in MAY_USE[folder]:
        assert any(is_within(module, allowed) for module in used), f"{folder} needs no {allowed}"


def test_the_picture_and_the_tables_are_those_of_the_law() -> None:
    written = PAGE.read_text(encoding="utf-8")
    assert picture() == PICTURE.read_text(encoding="utf-8"), "stale: run scripts/architecture"
    assert page(written) == written, "stale: run scripts/architecture"


def folder_of(module: str) -> str:
    """The folder of our module `module`, or of the module that contains this name."""
    path = ROOT.joinpath(*module.split("."))
    while not (path.is_dir() or path.with_suffix(".py").is_file()):
        path = path.parent
    folder = path if path.is_dir() else path.parent
    return folder.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("package", HOUSE)
def test_folders_import_from_the_floors_below(package: str) -> None:
    floors = {folder: n for n, row in enumerate(FLOORS[package]) for folder in row}
    assert not [folder for folder in floors if not python_files(folder)]
    for file in python_files(package):
        folder = file.parent.relative_to(ROOT).as_posix()
        assert folder in floors, f"{folder} has no floor"
        if file.name in ("__init__.py", "__main__.py"):
            continue  # a package's __init__ exports its contents; a command is above everything
        for module in imported_modules(file):
            if module.split(".")[0] == package and module != package:
                other = folder_of(module)
                below = other == folder or floors[other] < floors[folder]
                assert below, f"{file.relative_to(ROOT)} imports {module}"


def test_a_file_is_found_by_its_name() -> None:
    """No two source files share a name, except those with the same role in every package."""
    shared = {"__init__", "__main__", "errors", "config"}
    stems = Counter(file.stem for file in house_files() if file.stem not in shared)
    assert not {stem: count for stem, count in stems.items() if count > 1}


def test_nobody_is_told_to_install_a_package_that_is_not_ours() -> None:
    """`swings` on a package index would be another program; extras come from the checkout:
    `pip install '.[s3]'`."""
    files = [*house_files(), *python_files("bench"), *python_files("fuzz")]
    files += [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("codec/*.md")]
    files += [path for path in (ROOT / "deploy").iterdir() if path.is_file()]
    wrong = re.compile(r"swings\[|pip install swings\b")
    assert not [f for f in files if wrong.search(f.read_text(encoding="utf-8"))]


def test_only_what_runs_on_devices_imports_torch() -> None:
    for file in house_files():
        tops = {m.split(".")[0] for m in imported_modules(file)}
        may = file.parent == ROOT / "trainer" / "step" / "device"
        assert may or not tops & {"torch", "gsplat"}, file


@pytest.mark.parametrize("command", ["train", "evaluate", "synth"])
def test_the_help_of_the_trainer_waits_for_no_large_library(command: str) -> None:
    large = ["numba", "torch", "gsplat", "matplotlib", "ray"] + ["av"] * (command == "train")
    code = (
        "import sys, trainer.__main__ as commands\n"
        "sys.argv = ['command', '--help']\n"
        "try:\n"
        f"    commands.{command}()\n"
        "except SystemExit as done:\n"
        f"    sys.exit(done.code or ' '.join(n for n in {large} if n in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert "usage" in done.stdout
    assert done.stderr.strip() == ""


def test_no_module_imports_from_a_command() -> None:
    """A `__main__` is only started; code that others need belongs into a module."""
    for file in house_files():
        # swings-stream is a command of codec that uses the player's renderer.
        may = file == ROOT / "player" / "streamcommand.py"
        named = [m for m in imported_modules(file) if "__main__" in m.split(".")]
        assert may or not named, f"{file.relative_to(ROOT)} imports {named}"


@pytest.mark.parametrize("place", PURE)
def test_what_is_simulated_is_pure(place: str) -> None:
    for file in python_files(place) or [ROOT / place]:
        tops = {m.split(".")[0] for m in imported_modules(file)}
        assert not tops & NO_IO, f"{file.relative_to(ROOT)} imports {tops & NO_IO}"


def module_name(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def test_no_module_imports_itself_in_a_circle() -> None:
    """So each of them can be imported first; `deep` imports them so."""
    modules = {module_name(file) for file in house_files()}
    needed: dict[str, set[str]] = {}
    for file in house_files():
        name, named = module_name(file), imported_modules(file, on_import=True)
        from_packages = {module.rpartition(".")[0] for module in named & modules}
        needed[name] = named & modules - from_packages
        for module in named & modules:
            parents = accumulate(module.split(".")[:-1], "{}.{}".format)
            needed[name] |= {parent for parent in parents if not is_within(name, parent)}
    TopologicalSorter(needed).prepare()


@pytest.mark.deep
def test_every_module_imports_alone() -> None:
    modules = [*map(module_name, house_files())]
    # One new interpreter; each module is loaded with none of ours in memory.
    code = (
        "import importlib, sys\n"
        f"for name in {modules!r}:\n"
        f"    for loaded in [m for m in sys.modules if m.split('.')[0] in {HOUSE!r}]:\n"
        "        del sys.modules[loaded]\n"
        "    importlib.import_module(name)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


def test_no_catch_all_modules_and_short_commands() -> None:
    for file in house_files():
        assert file.stem not in {"utils", "util", "common", "helpers", "misc"}, file
        if file.name == "__main__.py":
            assert len(file.read_text(encoding="utf-8").splitlines()) <= 80, file


def test_no_test_folder_wears_a_package_name() -> None:
    # tests/codec/__init__.py would be imported as `codec` and hide the real one.
    assert not [name for name in HOUSE if (ROOT / "tests" / name / "__init__.py").exists()]


def test_a_test_sleeps_for_a_reason_and_is_of_three_kinds() -> None:
    """docs/TESTING.md says which kinds there are."""
    known = {"anyio", "filterwarnings", "parametrize", "skipif", "timeout", "usefixtures", "xfail"}
    known |= {"realtime", "deep"}
    scripts = [*ROOT.glob("player/web/test/**/*.mjs"), *ROOT.glob("tests/codec/interop/*.mjs")]
    for file in [*python_files("tests"), *scripts]:
        text = file.read_text(encoding="utf-8")
        for line in text.splitlines():
            assert not re.search(r"sleep\(", line) or re.search(r"(#|//) sleeps: ", line), file
        assert set(re.findall(r"pytest\.mark\.(\w+)", text)) <= known, file


def test_what_git_would_ship_is_not_ignored() -> None:
    """hatchling leaves ignored files out of a wheel: shaders and FORMAT.md must not be."""
    assets = [*ROOT.glob("player/render/gl/shaders/*"), ROOT / "codec" / "FORMAT.md"]
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    done = subprocess.run(
        ["git", "check-ignore", *map(str, assets)], cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout == ""

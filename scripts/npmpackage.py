"""Packs player/web as the npm package swings-player; see scripts/npmpackage."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WEB = ROOT / "player" / "web"
TOOLS = ROOT / "tests" / "player" / "web" / "node_modules" / ".bin"
LEFT_OUT = {"npm", "bundle", "test"}
"""Folders of player/web that are not modules of the player."""

WORKER = re.compile(r'new URL\("(\.{1,2}/[\w./]*worker\.js)", import\.meta\.url\)')
"""A module of player/web that starts as a worker."""

TAG_TYPES = """
declare global {
  interface HTMLElementTagNameMap {
    "swings-player": SwingsPlayerElement;
  }
}
"""


class ToolError(Exception):
    """A tool of the build failed; the message contains its output."""


def assemble(folder: Path) -> None:
    """Writes the files of the package into the empty `folder`."""
    modules = [
        path for path in sorted(WEB.rglob("*.js")) if path.relative_to(WEB).parts[0] not in LEFT_OUT
    ]
    workers: set[Path] = set()
    for path in modules:
        target = folder / path.relative_to(WEB)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(with_packed_workers(path, workers), encoding="utf-8")
    shutil.copy(WEB / "watch.html", folder)
    shutil.copy(ROOT / "LICENSE", folder)
    shutil.copy(WEB / "npm" / "README.md", folder)
    write_description(folder)
    bundle_workers(sorted(workers), folder / "workers")


def with_packed_workers(path: Path, workers: set[Path]) -> str:
    """The text of a module, with URLs of bundles in `workers/`; adds the sources to `workers`."""
    up = "../" * (len(path.relative_to(WEB).parts) - 1) or "./"

    def packed(found: re.Match[str]) -> str:
        worker = (path.parent / found[1]).resolve()
        workers.add(worker)
        return f'new URL("{up}workers/{worker.name}", import.meta.url)'

    return WORKER.sub(packed, path.read_text(encoding="utf-8"))


def bundle_workers(workers: list[Path], folder: Path) -> None:
    """Bundles each worker into one file, because bundlers copy it without following its imports."""
    arguments = [str(TOOLS / "esbuild"), *map(str, workers), "--bundle", "--format=esm"]
    names = ["--entry-names=[name]", f"--outdir={folder}"]
    run([*arguments, "--target=es2022", "--log-level=warning", *names])


def write_types(folder: Path) -> None:
    """Writes declarations beside the modules of the package in `folder`, from their JSDoc."""
    # The TypeScript project has scripts outside player/web, too.
    with tempfile.TemporaryDirectory() as scratch:
        places = ["--rootDir", str(ROOT), "--outDir", scratch]
        arguments = [str(TOOLS / "tsc"), "-p", str(WEB), *places]
        run([*arguments, "--noEmit", "false", "--declaration", "--emitDeclarationOnly"])
        declarations = Path(scratch) / WEB.relative_to(ROOT)
        for name in LEFT_OUT:
            shutil.rmtree(declarations / name, ignore_errors=True)
        shutil.copytree(declarations, folder, dirs_exist_ok=True)
    for path in folder.rglob("*.d.ts"):
        text = path.read_text(encoding="utf-8")
        # TypeScript has no types of WebXR, and the package depends on no other.
        names = sorted(set(re.findall(r"\bXR[A-Z]\w+", text)))
        path.write_text(text + "".join(f"type {name} = any;\n" for name in names), "utf-8")
    element = folder / "element" / "swingsplayer.d.ts"
    element.write_text(element.read_text(encoding="utf-8") + TAG_TYPES, encoding="utf-8")


def write_description(folder: Path) -> None:
    # Not tomllib, which Python has only from 3.11 on.
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    facts = dict(re.findall(r'^(version|license) = "(.*)"$', project, re.MULTILINE))
    description = json.loads((WEB / "npm" / "package.json").read_text(encoding="utf-8"))
    description.update(facts)
    text = json.dumps(description, indent=2) + "\n"
    (folder / "package.json").write_text(text, encoding="utf-8")


def pack(folder: Path, out: Path) -> Path:
    """Packs the package in `folder` into `out`; returns the path of the tarball."""
    out.mkdir(parents=True, exist_ok=True)
    command = ["npm", "pack", "--silent", "--ignore-scripts", "--pack-destination", str(out)]
    return out / run([*command, str(folder)]).split()[-1]


def run(command: list[str]) -> str:
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        raise ToolError(f"{Path(command[0]).name} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def main() -> None:
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "dist" / "npm"
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "swings-player"
        folder.mkdir()
        try:
            assemble(folder)
            write_types(folder)
            sys.stdout.write(f"{pack(folder, out)}\n")
        except ToolError as error:
            sys.exit(f"npmpackage: {error}")


if __name__ == "__main__":
    main()

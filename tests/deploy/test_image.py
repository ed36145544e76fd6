"""The image of deploy/Dockerfile: its contents, and that the server runs with them alone."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import urllib.request
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.deploy.dockerfile import ROOT, SERVED, build_commands, copied, instructions, pins
from tests.deploy.proxied import DEPLOY
from tests.support.commands import serving
from tests.support.hosted_streams import write_stream
from tests.support.stores.s3_server import BUCKET, s3_server
from tests.support.waiting import BOUND_S, wait_until

BUILD = DEPLOY / "requirements-build.txt"
STALE = "stale: run scripts/requirements"


def direct() -> set[str]:
    """The packages that deploy/requirements.in names."""
    lines = (DEPLOY / "requirements.in").read_text().splitlines()
    return {canonicalize_name(line) for line in lines if not line.startswith("#")}


def needed(names: set[str]) -> set[str]:
    """These packages and all their dependencies, according to the installed ones."""
    found, left = set(), list(names)
    while left:
        name = left.pop()
        if name in found:
            continue
        found.add(name)
        for line in importlib.metadata.requires(name) or ():
            requirement = Requirement(line)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                left.append(canonicalize_name(requirement.name))
    return found


def test_the_image_gets_our_dependencies_at_our_versions() -> None:
    given = tomllib.loads((ROOT / "pyproject.toml").read_text())
    lines = [*given["project"]["dependencies"], *given["project"]["optional-dependencies"]["s3"]]
    ours = {requirement.name: requirement for requirement in map(Requirement, lines)}
    assert direct() <= set(ours)
    served, all_pins = pins(SERVED), pins(ROOT / "constraints.txt")
    assert set(served) == needed(direct()), STALE
    assert served == {name: all_pins[name] for name in served}, STALE
    for name in direct():
        assert ours[name].specifier.contains(served[name]), STALE
    building = pins(BUILD)
    for requirement in map(Requirement, given["build-system"]["requires"]):
        assert requirement.specifier.contains(building[canonicalize_name(requirement.name)]), STALE


@pytest.mark.parametrize("file", [SERVED, BUILD], ids=lambda file: str(file.name))
def test_every_package_has_hashes_and_no_line_names_a_host(file: Path) -> None:
    text = file.read_text()
    assert "://" not in text
    assert "--" not in text.replace("--hash=sha256:", "")
    for entry in re.split(r"\n(?=\w)", text.strip()):
        assert re.search(r"==\S+ \\\n( +--hash=sha256:[0-9a-f]{64}( \\\n|$))+", entry), entry


def test_the_dockerfile_copies_what_is_there_and_runs_as_nobody_special() -> None:
    steps = instructions()
    assert [rest for name, rest in steps if name == "FROM"] == [
        "${PYTHON_IMAGE} AS build",
        "${PYTHON_IMAGE}",
    ]
    assert steps[0][0] == "ARG"
    # A digest, because the tag gets another image with each release of Debian.
    digest = r"PYTHON_IMAGE=python:3\.11\.\d+-slim-trixie@sha256:[0-9a-f]{64}"
    assert re.fullmatch(digest, steps[0][1])
    for source in copied():
        assert (ROOT / source).exists(), source
    last = len(steps) - 1 - [name for name, _ in reversed(steps)].index("FROM")
    names = dict(steps[last:])
    assert names["USER"] == "10001"
    for name in ("ENTRYPOINT", "CMD"):
        assert isinstance(json.loads(names[name]), list)


def test_what_docker_ignores_is_all_but_what_is_copied() -> None:
    lines = (DEPLOY / "Dockerfile.dockerignore").read_text().split()
    assert lines[0] == "*"
    assert {line[1:] for line in lines if line.startswith("!")} == set(copied())


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with only the packages of deploy/requirements.txt."""
    folder = tmp_path_factory.mktemp("packages")
    for name in pins(SERVED):
        distribution = importlib.metadata.distribution(name)
        for top in {file.parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
            (folder / top).symlink_to(Path(str(distribution.locate_file(top))))
    return folder


def read(url: str) -> bytes:
    with urllib.request.urlopen(url, timeout=BOUND_S) as response:
        body: bytes = response.read()
    return body


def check_serves(url: str, stream: Path) -> None:
    """Checks a page, a file of the player, a play, metrics and files of the stream."""
    for path in ("/", "/watch/walk", "/healthz", "/v1/streams", "/v1/streams/walk/play?from=0"):
        assert read(url + path), path
    # The counts of another worker arrive a moment later.
    wait_until(lambda: b"swings_requests_total{" in read(f"{url}/metrics"))
    for file in ("manifest.json", "segments/1/0"):
        assert read(f"{url}/v1/streams/walk/{file}") == (stream / file).read_bytes()


def python_with(packages: Path, code: str) -> list[str]:
    """A command that runs `code` with only `packages`, our code and the standard library
    importable."""
    paths = [str(ROOT), str(packages)]
    return [sys.executable, "-I", "-S", "-c", f"import sys; sys.path += {paths}\n{code}"]


SERVE = "from server.__main__ import main; main()"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stream(tmp_path_factory.mktemp("root") / "walk", 20, fps=10.0).parent


@pytest.mark.parametrize("workers", ["1", "2"])
def test_the_server_needs_no_other_package(packages: Path, root: Path, workers: str) -> None:
    with serving(root, "--workers", workers, program=python_with(packages, SERVE)) as url:
        check_serves(url, root / "walk")


def test_the_server_of_an_object_store_needs_no_other_package(packages: Path, root: Path) -> None:
    with s3_server() as store:
        store.upload(root / "walk", "streams/walk")
        with serving(f"s3://{BUCKET}/streams", program=python_with(packages, SERVE)) as url:
            check_serves(url, root / "walk")


def test_urls_are_signed_without_another_package(packages: Path, tmp_path: Path) -> None:
    command = python_with(packages, "from server.operate.sign.__main__ import main; main()")
    subprocess.run([*command, str(tmp_path / "keys"), "--new-key"], check=True)
    done = subprocess.run(
        [*command, str(tmp_path / "keys"), "show"], check=True, capture_output=True, text=True
    )
    assert "/t/" in done.stdout


def test_other_packages_cannot_be_imported_there(packages: Path) -> None:
    """Otherwise the tests above would prove nothing."""
    for name, found in {"numpy": 0, "numba": 1, "pytest": 1}.items():
        done = subprocess.run(python_with(packages, f"import {name}"), capture_output=True)
        assert done.returncode == found, name


@pytest.mark.deep
def test_the_image_is_built_and_serves(root: Path, tmp_path: Path) -> None:
    """Runs the first stage's commands, in other folders and with pip's cache; then the server."""
    source, opt = tmp_path / "source", tmp_path / "opt"
    for name in copied():
        path = ROOT / name
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(path, source / name, ignore=ignored)
        else:
            shutil.copy(path, source / name)
    bare = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    for command in build_commands():
        line = command.replace("/opt/", f"{opt}/").replace(" --no-cache-dir", "")
        done = subprocess.run(
            ["sh", "-c", line], cwd=source, env=bare, capture_output=True, text=True
        )
        if "Could not find a version that satisfies" in done.stderr:
            pytest.skip("no package index can be reached")
        assert done.returncode == 0, f"{line}\n{done.stderr[-2000:]}"
    commands = sorted(path.name for path in (opt / "swings/bin").glob("swings-*"))
    assert commands == ["swings-serve", "swings-sign"]
    site = next((opt / "swings/lib").glob("python*/site-packages"))
    for wanted in ("codec/FORMAT.md", "server/app.py", "player/web/bundle/watch.html"):
        assert (site / wanted).exists(), wanted
    for left_out in ("pip", "numba", "scipy", "matplotlib", "moderngl", "torch"):
        assert not (site / left_out).exists(), left_out
    with serving(root, program=[str(opt / "swings/bin/swings-serve")]) as url:
        check_serves(url, root / "walk")


def test_the_bill_of_materials_has_the_versions_and_hashes_of_the_image(tmp_path: Path) -> None:
    pytest.importorskip("cyclonedx_py", reason="cyclonedx-bom is not installed")
    script = (ROOT / "scripts" / "sbom").read_text()
    arguments = "requirements deploy/requirements.txt --mc-type application --output-file"
    common = "--pyproject pyproject.toml --output-reproducible --of JSON"
    assert arguments in script
    assert common in script
    out = tmp_path / "bill.json"
    words = ["-W", "ignore::UserWarning:cyclonedx.model.bom", "-m", "cyclonedx_py"]
    words += [*arguments.split(), str(out), *common.split()]
    subprocess.run([sys.executable, *words], cwd=ROOT, check=True)
    bill = json.loads(out.read_text())
    assert bill["bomFormat"] == "CycloneDX"
    assert bill["metadata"]["component"]["name"] == "swings"
    found = {canonicalize_name(part["name"]): part for part in bill["components"]}
    assert {name: part["version"] for name, part in found.items()} == pins(SERVED)
    for name, part in found.items():
        assert part["purl"] == f"pkg:pypi/{name}@{part['version']}"
        hashes = [entry for link in part["externalReferences"] for entry in link["hashes"]]
        assert hashes
        for entry in hashes:
            assert entry["alg"] == "SHA-256"
            assert entry["content"] in SERVED.read_text()

"""Parsers of deploy/Dockerfile and deploy/requirements.txt."""

from __future__ import annotations

import re
from pathlib import Path

from packaging.utils import canonicalize_name

from tests.deploy.proxied import DEPLOY

ROOT = DEPLOY.parent
DOCKERFILE = DEPLOY / "Dockerfile"
SERVED = DEPLOY / "requirements.txt"


def instructions() -> list[tuple[str, str]]:
    """All instructions, with continued lines joined."""
    text = DOCKERFILE.read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [(name, rest.strip()) for name, _, rest in (line.partition(" ") for line in lines)]


def build_commands() -> list[str]:
    """The commands of the first stage."""
    steps = instructions()
    begins = [n for n, (name, _) in enumerate(steps) if name == "FROM"]
    return [rest for name, rest in steps[begins[0] : begins[1]] if name == "RUN"]


def copied() -> list[str]:
    """The files and folders of the repository that the first stage copies."""
    found = []
    for name, rest in instructions():
        if name == "COPY" and not rest.startswith("--from"):
            found += rest.split()[:-1]
    return found


def pins(file: Path) -> dict[str, str]:
    """The version of each package in the file."""
    found = re.findall(r"^([\w.-]+)==(\S+)", file.read_text(), flags=re.MULTILINE)
    return {canonicalize_name(name): version for name, version in found}

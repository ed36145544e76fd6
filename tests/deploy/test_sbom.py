"""The bill of materials of the container. scripts/package checks that of the wheel."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from packaging.utils import canonicalize_name

from tests.deploy.dockerfile import ROOT, SERVED, pins


def test_it_names_what_the_image_gets_with_versions_and_hashes(tmp_path: Path) -> None:
    pytest.importorskip("cyclonedx_py", reason="cyclonedx-bom is not installed")
    script = (ROOT / "scripts" / "sbom").read_text()
    arguments = "requirements deploy/requirements.txt --mc-type application --output-file"
    common = "--pyproject pyproject.toml --output-reproducible --of JSON"
    assert arguments in script
    assert common in script
    out = tmp_path / "bill.json"
    subprocess.run(
        [
            *(sys.executable, "-W", "ignore::UserWarning:cyclonedx.model.bom", "-m"),
            *("cyclonedx_py", *arguments.split(), str(out), *common.split()),
        ],
        cwd=ROOT,
        check=True,
    )
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

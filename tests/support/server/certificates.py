"""Certificates for tests only."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest


def make_certificate(folder: Path, names: str = "DNS:localhost") -> tuple[Path, Path]:
    """Writes a self-signed certificate for `names`, in the syntax of OpenSSL, and its key: `cert`
    and `key` in `folder`."""
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl")
    folder.mkdir(parents=True, exist_ok=True)
    cert, key = folder / "cert", folder / "key"
    words = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2"]
    words += ["-subj", "/CN=swings", "-addext", f"subjectAltName={names}"]
    words += ["-keyout", str(key), "-out", str(cert)]
    subprocess.run(words, check=True, capture_output=True)
    return cert, key

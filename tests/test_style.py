"""The sources pass the linter and the strict type checker; pyproject.toml configures both."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def run(*command: str) -> None:
    done = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_ruff():
    run("ruff", "check", "--no-cache", "solari_vk", "tests", "tools", "hatch_build.py")


def test_mypy():
    run("mypy")


def test_format():
    run("ruff", "format", "--no-cache", "--check", "solari_vk", "tests", "tools", "hatch_build.py")

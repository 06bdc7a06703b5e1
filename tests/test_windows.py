"""Windows: what only other systems have is behind a look at the platform, and the package runs under Wine."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "out" / "windows"  # kept, so that the next run takes a minute

pytestmark = pytest.mark.slow


def test_types_are_those_of_windows_too(tmp_path):
    """The type checker knows which functions a platform has."""
    command = [sys.executable, "-m", "mypy", "--platform", "win32", "--cache-dir", tmp_path]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.posix
def test_the_package_runs_under_wine(any_device):
    if not (shutil.which("wine64") or os.path.exists("/usr/lib/wine/wine64")) or not shutil.which("Xvfb"):
        pytest.skip("Wine or Xvfb is missing: tools/windows installs them on Debian")
    environment = {**os.environ, "PYTHON": sys.executable, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [ROOT / "tools" / "windows", FOLDER], env=environment, capture_output=True, text=True, check=False
    )
    said = done.stdout
    assert done.returncode == 0, said + done.stderr
    assert re.search(r"tests: \d{2,} passed", said), said
    assert len(re.findall("have the same bits as on Linux", said)) == 2, said

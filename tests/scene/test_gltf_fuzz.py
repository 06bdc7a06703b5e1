"""Thousands of mutated files: each loads or is refused with a SolariError, quickly and in bounded memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

PARTS, COUNT = 4, 600  # fixed seeds, 2,400 files


@pytest.mark.parametrize("part", range(PARTS))
def test_mutated_files(tmp_path, part):
    script = Path(__file__).with_name("fuzz_gltf.py")
    # Threads of the linear algebra library would only reserve memory.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", str(script), str(tmp_path), str(COUNT), str(part * COUNT)],
        capture_output=True, text=True, timeout=300, env=environment, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-5000:]
    counts = json.loads(run.stdout.splitlines()[-1])
    assert counts["failed"] == 0, run.stdout[-5000:]
    assert counts["peak_mib"] < 1024
    assert min(counts["loaded"], counts["refused"]) > COUNT // 10, "both outcomes must be common, or this proves little"

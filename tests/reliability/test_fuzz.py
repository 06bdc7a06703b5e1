"""Thousands of mutated files: each loads or is refused with a SolariError, quickly and in bounded memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz_seeds import KINDS

# How many files there are in each part; parts have fixed seeds.
COUNTS = {**dict.fromkeys(KINDS, 150), "gltf": 600}
PARTS = [*(("gltf", part) for part in range(4)), *((kind, 0) for kind in KINDS if kind != "gltf")]


@pytest.mark.parametrize(("kind", "part"), PARTS)
def test_mutated_files(tmp_path, kind, part):
    count = COUNTS[kind]
    script, folder = Path(__file__).with_name("fuzz.py"), tmp_path / "files"
    folder.mkdir()
    # Threads of the linear algebra library would only reserve memory.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", str(script), kind, *map(str, (folder, count, part * count))],
        capture_output=True, text=True, timeout=300, env=environment, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-5000:]
    counts = json.loads(run.stdout.splitlines()[-1])
    assert counts["failed"] == 0, run.stdout[-5000:]
    assert counts["peak_mib"] < 1024
    assert min(counts["loaded"], counts["refused"]) > count // 25, "both outcomes must be common, or this proves little"

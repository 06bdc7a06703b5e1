"""Mutated glTF files that load are rendered under validation by both renderers: finite pictures, no hang."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz_seeds import GLTF

COUNT = 250  # mutants of each kind that load


@pytest.mark.slow
def test_mutants_are_rendered(device, tmp_path):
    """A thousand, among them all kinds of glTF files."""
    program = Path(__file__).with_name("render_mutants.py")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    if "(LLVM 15" in device.name:
        environment["GALLIVM_PERF"] = "nopt"  # it would optimize shaders with many features for minutes
    done = subprocess.run(
        [sys.executable, program, tmp_path, str(COUNT), "0", *GLTF],
        capture_output=True,
        text=True,
        timeout=7200,
        env=environment,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-5000:]
    counts = json.loads(done.stdout.splitlines()[-1])
    assert set(counts) == set(GLTF)
    for kind, found in counts.items():
        assert found["rendered"] > COUNT // 2, f"{kind}: most mutants that load must be rendered: {found}"

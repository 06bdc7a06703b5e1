"""Shaders that tests write, and the validation of their SPIR-V."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

HEADER = "#version 460\n#extension GL_EXT_scalar_block_layout : require\n"


def check_spirv(spirv: bytes, name: str) -> None:
    """Fail if the module isn't valid for Vulkan 1.3 with scalar layout, by spirv-val or what SPIRV_VAL names."""
    command = shutil.which(os.environ.get("SPIRV_VAL", "spirv-val"))
    assert command, "spirv-val is missing: install spirv-tools"
    arguments = [command, "--target-env", "vulkan1.3", "--scalar-block-layout", "-"]
    done = subprocess.run(arguments, input=spirv, capture_output=True, check=False)
    # Debian's spirv-val doesn't know this extension of 2023. The driver validates such modules.
    too_new = b"SPV_KHR_ray_tracing_position_fetch" in spirv and b"Invalid capability operand: 5391" in done.stderr
    assert done.returncode == 0 or too_new, f"{name}: {done.stderr.decode()}{done.stdout.decode()}"


class ShaderFolder:
    """Writes shaders below a folder. `write("demo", text)` writes passes/demo.comp with the usual first lines.

    `compiled`: the modules that were compiled during the test, with the names of their sources.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.compiled: list[tuple[bytes, str]] = []
        (root / "passes").mkdir(parents=True, exist_ok=True)

    def write(self, name: str, text: str) -> Path:
        path = self.root / (name if "." in name else f"passes/{name}.comp")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text if "." in name else HEADER + text)
        return path

"""Seeded bugs, and the rules that must be red with them. Every rule of the suite has one."""

from __future__ import annotations

import shutil

import numpy as np

from solari_vk.gpu.shaders import compiler


def patched_root(tmp_path, *patches):
    """A copy of the shaders with seeded bugs: (file, text that it holds once, text put in its place)."""
    root = tmp_path / "glsl"
    shutil.copytree(compiler.glsl_root(), root, ignore=shutil.ignore_patterns("*.spv", "*.json"))
    for file, old, new in patches:
        path = root / file
        text = path.read_text()
        assert text.count(old) == 1, f"{file} has changed: '{old}' must be found once"
        path.write_text(text.replace(old, new))
    return root


def failing(measurements):
    """The names of the rules that don't hold."""
    return {measured.rule.name for measured in measurements if not measured.holds}


def expect_red(measurements, *parts):
    """Each part is in the name of a rule that fails."""
    names = failing(measurements)
    for part in parts:
        assert any(part in name for name in names), f"{part} must fail; what fails is {sorted(names)}"


def masked(field, mask):
    """Damage to instance records: only these bits of a field are left."""

    def damage(records):
        records[field] &= np.uint32(mask)

    return damage

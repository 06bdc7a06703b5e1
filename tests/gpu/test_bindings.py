"""Numbers of bindings: passes of any two stages may be in one frame, so that no two resources may share a number."""

import re
from collections import defaultdict

from solari_vk.gpu.shaders.compiler import glsl_root

APART = {"conformance", "bench", "brdf_table", "viewer", "ray_tracer"}  # never in a frame with others
BINDING = re.compile(r"layout\(([^)]*\bset = 1\b[^)]*)\)[^;{]*?\b(\w+)\s*[{;]")


def test_each_binding_of_a_frame_has_its_number():
    owners = defaultdict(set)
    for path in (glsl_root() / "passes").rglob("*.glsl"):
        if path.parent.name not in APART:
            for qualifiers, name in BINDING.findall(path.read_text()):
                owners[int(re.search(r"binding = (\d+)", qualifiers)[1])].add(name)
    assert len(owners) > 60
    assert {number: names for number, names in owners.items() if len(names) > 1} == {}

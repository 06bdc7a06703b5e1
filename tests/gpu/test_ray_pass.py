"""Passes with ray generation, miss and hit shaders of their own, and the shader binding table behind them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from shader_folder import HEADER
from support.frames import leaves_nothing

from solari_vk import HitGroup, RayPass, rt
from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame import ray_pipelines, slot
from solari_vk.gpu.frame.frame import Frame, Pass, Stage, Step

RAYS = """#extension GL_EXT_ray_tracing : require
struct Ray { vec3 origin; uint offset; uint stride; uint miss; };
layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, binding = 0, scalar) readonly buffer RaysBlock { Ray at[]; } rays;
layout(set = 1, binding = 1, scalar) buffer FoundBlock { uint at[]; } found;
"""
GENERATE = (
    RAYS
    + """layout(location = 0) rayPayloadEXT uint payload;
void main() {
    uint i = gl_LaunchIDEXT.y * gl_LaunchSizeEXT.x + gl_LaunchIDEXT.x;
    Ray ray = rays.at[i];
    payload = 1u;
    traceRayEXT(tlas, 0u, 0xFFu, ray.offset, ray.stride, ray.miss, ray.origin, 0.0, vec3(0, 0, -1), 100.0, 0);
    found.at[i] = payload;
}
"""
)
PAYLOAD = "#extension GL_EXT_ray_tracing : require\nlayout(location = 0) rayPayloadInEXT uint payload;\n"
ADDS = "layout(constant_id = 0) const uint ADDED = 0u;\nvoid main() {{ payload = payload * {} + ADDED; }}\n"
SHADERS = {
    "passes/demo.rgen": GENERATE,
    "passes/demo/miss.rmiss": PAYLOAD + ADDS.format("2u"),
    "passes/demo/other.rmiss": PAYLOAD + ADDS.format("3u"),
    "passes/demo/hit.rchit": PAYLOAD + ADDS.format("5u"),
    "passes/demo/other.rchit": PAYLOAD + ADDS.format("7u"),
    "passes/demo/left.rahit": PAYLOAD
    + "void main() { payload *= 11u; if (gl_InstanceCustomIndexEXT == 1) { ignoreIntersectionEXT; } }\n",
    "passes/demo/box.rint": "#extension GL_EXT_ray_tracing : require\n"
    + "void main() { reportIntersectionEXT(gl_RayTminEXT + 2.0, 0u); }\n",
}
MISSES = ["passes/demo/miss.rmiss", "passes/demo/other.rmiss"]
HITS = [
    HitGroup("passes/demo/hit.rchit"),
    HitGroup("passes/demo/other.rchit"),
    HitGroup("passes/demo/hit.rchit", "passes/demo/left.rahit"),
    HitGroup("passes/demo/other.rchit", intersection="passes/demo/box.rint"),
    HitGroup(),
]
RAY = np.dtype([("origin", "f4", 3), ("offset", "u4"), ("stride", "u4"), ("miss", "u4")])


@pytest.fixture(scope="module")
def ray_device(any_device: None) -> Iterator[Device]:
    with Device(validation=True, rays="pipeline") as opened:
        yield opened
        opened.wait_idle()


@pytest.fixture(scope="module")
def tlas(ray_device: Device) -> Iterator[rt.Tlas]:
    """Two triangles, one behind the other in two geometries, at x 0; the same with index 1 at x 10; a box at x 20."""
    near, far = (np.array([(-1, -1, z), (1, -1, z), (0, 1, z)], np.float32) for z in (0, -1))
    triangles = [rt.Triangles(part, opaque=False, no_duplicate_any_hit=True) for part in (near, far)]
    boxes = [rt.Aabbs(np.array([(-1, -1, -1, 1, 1, 1)], np.float32), opaque=False)]
    blases = [rt.create_blas(ray_device, geometry) for geometry in (triangles, boxes)]
    made = rt.create_tlas(ray_device, 3)
    at = [np.hstack([np.eye(3), [[x], [0], [0]]]) for x in (0, 10, 20)]
    instances = [
        rt.TlasInstance(blases[0], at[0]),
        rt.TlasInstance(blases[0], at[1], 1),
        rt.TlasInstance(blases[1], at[2]),
    ]
    entries = [rt.BlasBuildEntry(blases[0], triangles), rt.BlasBuildEntry(blases[1], boxes)]
    rt.build_acceleration_structures(ray_device, entries, [rt.TlasPackage(made, instances)])
    yield made
    for structure in (made, *blases):
        structure.destroy()


# where the ray starts (x, z), its record offset, record stride and miss index; and what its shaders return
CASES = {
    "miss": ((50, 5, 0, 0, 0), 2),
    "second miss": ((50, 5, 0, 0, 1), 3),
    "first geometry, first record": ((0, 5, 0, 0, 0), 5),
    "first geometry, second record": ((0, 5, 1, 0, 0), 7),
    "first geometry, stride": ((0, 5, 0, 1, 0), 5),
    "second geometry, stride": ((0, -0.5, 0, 1, 0), 7),
    "second geometry, offset and stride": ((0, -0.5, 1, 3, 0), 1),
    "any-hit lets both triangles of instance 1 through": ((10, 5, 2, 0, 1), 11 * 11 * 3),
    "box": ((20, 5, 3, 0, 0), 7),
}


def run(device: Device, root: Any, tlas: rt.Tlas, item: Pass) -> np.ndarray:
    """What the rays of CASES return."""
    rays = np.array([((x, 0, z), *records) for (x, z, *records), _ in CASES.values()], RAY)
    stage = Stage("demo", buffers={"rays": len(rays), "found": len(rays)}, passes=[item])
    with Frame(device, [stage], external={"tlas": tlas}, glsl_root=root) as frame:
        frame.resource("rays").upload(rays)
        frame.submit()
        return frame["found"]


@pytest.fixture
def root(shaders):
    for path, text in SHADERS.items():
        shaders.write(path, HEADER + text)
    return shaders.root


def test_rays_run_the_shaders_of_their_records(ray_device, root, tlas):
    wanted = [value for _, value in CASES.values()]
    for threads in (len(CASES), (3, 3)):
        found = run(ray_device, root, tlas, RayPass("demo", threads=threads, misses=MISSES, hits=HITS))
        assert dict(zip(CASES, found.tolist(), strict=True)) == dict(zip(CASES, wanted, strict=True))
    constant = RayPass("demo", threads=len(CASES), misses=MISSES, hits=HITS, constants={"ADDED": 1000})
    found = run(ray_device, root, tlas, constant)
    np.testing.assert_array_equal(found, [value + (1000 if value > 1 else 0) for value in wanted])


def test_a_frame_in_parts_launches_its_rays_once(ray_device, root, shaders, tlas, monkeypatch):
    monkeypatch.setattr(slot, "PART_GROUPS", 2)
    shaders.write("passes/adds.rgen", HEADER + GENERATE.replace("found.at[i] =", "found.at[i] +="))
    item = RayPass("adds", threads=(3, 3), misses=MISSES, hits=HITS)
    stage = Stage("adds", buffers={"rays": len(CASES), "found": len(CASES)}, passes=[item])
    rays = np.array([((x, 0, z), *records) for (x, z, *records), _ in CASES.values()], RAY)
    with Frame(ray_device, [stage], external={"tlas": tlas}, glsl_root=root) as frame:
        frame.resource("rays").upload(rays)
        frame.between = lambda: False
        frame.submit()
        np.testing.assert_array_equal(frame["found"], [value for _, value in CASES.values()])


SEVERAL = RayPass("demo", threads=len(CASES), misses=MISSES, hits=HITS)


def test_only_passes_that_trace_wait_for_structures(ray_device, root, tlas, shaders):
    """Without ray queries no compute shader may (VUID-VkMemoryBarrier2-dstAccessMask-06256, by layers of 2026)."""
    structures = raw.VK_ACCESS_2_ACCELERATION_STRUCTURE_READ_BIT_KHR
    block = "layout(set = 1, binding = 1, scalar) buffer FoundBlock { uint at[]; } found;\n"
    shaders.write("add", f"layout(local_size_x = 64) in;\n{block}void main() {{ found.at[0] += 1u; }}\n")
    add, built = Pass("add", threads=1), Step("build", lambda _: None, writes=["tlas"])
    for steps, names, wait in (([add, add], ["found"], False), ([built, SEVERAL], ["found", "rays"], True)):
        stage = Stage("demo", buffers=dict.fromkeys(names, len(CASES)), passes=steps)
        with Frame(ray_device, [stage], external={"tlas": tlas}, glsl_root=root) as frame:
            targets = [barrier.target.access for barrier in frame._barriers if barrier]
        assert [bool(access & structures) for access in targets] == [wait]


@pytest.mark.parametrize("properties", [{"shaderGroupHandleAlignment": 64}, {"shaderGroupBaseAlignment": 256}])
def test_table_fits_other_alignments(ray_device, root, tlas, monkeypatch, properties):
    """NVIDIA wants 32-byte strides and 64-byte bases; larger alignments must give the same results."""
    real = ray_device.properties
    changed = SimpleNamespace(
        **{
            name: getattr(real.ray_pipelines, name)
            for name in (
                "shaderGroupHandleSize",
                "shaderGroupHandleAlignment",
                "shaderGroupBaseAlignment",
                "maxRayDispatchInvocationCount",
                "maxRayRecursionDepth",
            )
        }
        | properties
    )
    monkeypatch.setattr(ray_device, "properties", dataclasses.replace(real, ray_pipelines=changed))
    tables = []
    make = ray_pipelines.ShaderBindingTable.__init__

    def keep(self, *arguments):
        make(self, *arguments)
        tables.append(self.regions)

    monkeypatch.setattr(ray_pipelines.ShaderBindingTable, "__init__", keep)
    ray_device.trim()
    assert run(ray_device, root, tlas, SEVERAL).tolist() == [value for _, value in CASES.values()]
    (regions,) = tables
    stride, base = (max(32, properties.get(f"shaderGroup{name}Alignment", 0)) for name in ("Handle", "Base"))
    assert [region.stride for region in regions] == [stride, stride, stride, 0]
    assert [region.size // stride for region in regions] == [1, len(MISSES), len(HITS), 0]
    assert all(region.deviceAddress % base == 0 for region in regions)


@pytest.mark.parametrize("fails", ["buffer", "upload"])
def test_a_table_that_fails_names_its_pass_and_leaves_nothing(ray_device, root, tlas, monkeypatch, fails):
    """The pipelines of all passes exist when the first one's table fails."""
    run(ray_device, root, tlas, SEVERAL)
    real, made = ray_device.vk.vkCreateRayTracingPipelinesKHR, []
    passes = [dataclasses.replace(SEVERAL, constants={"ADDED": added}) for added in (1, 2, 3)]

    def create(*arguments: Any) -> int:
        made.append(real(*arguments))
        return 0

    def fail(*_: Any, **__: Any) -> None:
        raise DeviceError("no more memory")

    owner, name = (ray_device, "buffer") if fails == "buffer" else (Buffer, "upload")
    monkeypatch.setattr(ray_device.vk, "vkCreateRayTracingPipelinesKHR", create)
    monkeypatch.setattr(owner, name, fail)
    stage = Stage("demo", buffers={"rays": 1, "found": 1}, passes=passes)
    with leaves_nothing(ray_device), pytest.raises(DeviceError, match=r"^pass demo #1: no more memory"):
        Frame(ray_device, [stage], external={"tlas": tlas}, glsl_root=root)
    assert len(made) == len(passes)


def test_barriers_wait_for_ray_shaders(ray_device, root, tlas):
    """Synchronization validation 1.3.239 doesn't look at vkCmdTraceRaysKHR, so the masks are compared."""
    stage = Stage("demo", buffers={"rays": len(CASES), "found": len(CASES)}, passes=[SEVERAL, SEVERAL])
    with Frame(ray_device, [stage], external={"tlas": tlas}, glsl_root=root) as frame:
        frame.submit()
        assert [row.barrier for row in frame.describe()] == ["", "WAW found (demo #1)"]
        _, barrier = frame._barriers
        assert {barrier.source.stages, barrier.target.stages} == {raw.VK_PIPELINE_STAGE_2_RAY_TRACING_SHADER_BIT_KHR}
        assert barrier.source.access == raw.VK_ACCESS_2_SHADER_WRITE_BIT
        assert len(frame.timings) == 2


ARGUMENTS = """layout(set = 1, binding = 2, scalar) buffer ArgumentsBlock { uint at[]; } arguments;
void main() { if (gl_LaunchIDEXT == uvec3(9)) arguments.at[0] = 1u;"""
WITH_ARGUMENTS = HEADER + GENERATE.replace("void main() {", ARGUMENTS)
INDIRECT = RayPass("demo", indirect="arguments", indirect_offset=4, misses=MISSES, hits=HITS)


def test_indirect_launches_take_the_thread_counts(ray_device, root, tlas, monkeypatch):
    """They follow the workgroup counts, which a launch must not read."""
    (root / "passes/demo.rgen").write_text(WITH_ARGUMENTS)
    buffers = {"rays": len(CASES), "found": len(CASES), "arguments": 8}
    for offset, launched in ((slot.GROUP_COUNT_BYTES, len(CASES)), (0, 2)):
        monkeypatch.setattr(slot, "GROUP_COUNT_BYTES", offset)
        with Frame(
            ray_device, [Stage("demo", buffers=buffers, passes=[INDIRECT])], external={"tlas": tlas}, glsl_root=root
        ) as frame:
            frame.resource("arguments").upload(np.array([9, 2, 1, 1, 3, 3, 1, 0], np.uint32))
            frame.submit()
            assert np.count_nonzero(frame["found"]) == launched
            assert [row.reads for row in frame.describe()] == [("arguments", "rays", "tlas")]


def test_indirect_launches_need_thread_counts(ray_device, root, tlas):
    (root / "passes/demo.rgen").write_text(WITH_ARGUMENTS)
    stage = Stage("demo", buffers={"rays": len(CASES), "found": len(CASES)}, passes=[INDIRECT])
    given = {}
    for words in (6, 7):
        given[words] = ray_device.buffer(4 * words, f"{words} words")
        given[words].upload(np.array([0, 0, 0, 0, 2, 1, 1][:words], np.uint32))

    refused = r"^pass demo: .* buffer arguments has 24 bytes: give it at least 28, .* then three thread counts"
    with pytest.raises(SolariError, match=refused):
        Frame(ray_device, [stage], external={"tlas": tlas, "arguments": given[6]}, glsl_root=root)
    with Frame(ray_device, [stage], external={"tlas": tlas, "arguments": given[7]}, glsl_root=root) as frame:
        with pytest.raises(SolariError, match=refused):
            frame.bind({"arguments": given[6]})
        frame.submit()
        assert frame.resource("arguments") is given[7]
        assert np.count_nonzero(frame["found"]) == 2
    for buffer in given.values():
        buffer.destroy()


def test_a_constant_of_the_local_size_is_refused_with_the_reason(ray_device, shaders, tlas):
    shaders.write(
        "sized",
        '#include "scene/trace.glsl"\nlayout(local_size_x_id = 3) in;\n'
        "layout(constant_id = 3) const uint SIZE = 8u;\n"
        "layout(set = 1, binding = 0, scalar) buffer FoundBlock { uint at[]; } found;\n"
        "void main() { found.at[0] = uint(trace_visibility(vec3(0), vec3(1), 1.0)); }\n",
    )
    stage = Stage("sized", buffers={"found": 1}, passes=[Pass("sized", threads=1, constants={"SIZE": 4})])
    with pytest.raises(SolariError, match=r"^pass sized: .* no specialization constant SIZE; .*without a local size"):
        Frame(ray_device, [stage], external={"tlas": tlas}, glsl_root=shaders.root)


def test_mistakes_are_refused(ray_device, root, tlas, any_device):
    most = ray_device.properties.ray_pipelines.maxRayDispatchInvocationCount
    for threads in ((1 << 15, 1 << 15), (most + 1,)):
        with pytest.raises(SolariError, match=rf"pass demo: .* threads, but .* launch at most {most:,}"):
            run(ray_device, root, tlas, RayPass("demo", threads=threads, misses=MISSES, hits=HITS))
    for depth in (0, 10**6, 1.5):
        deep = RayPass("demo", threads=1, misses=MISSES, hits=HITS, max_recursion_depth=depth)
        with pytest.raises(SolariError, match=r"pass demo: max_recursion_depth is a whole number from 1 to \d+"):
            run(ray_device, root, tlas, deep)
    with pytest.raises(SolariError, match=r"no shader passes/demo/none\.rmiss"):
        run(ray_device, root, tlas, RayPass("demo", threads=1, misses=["passes/demo/none.rmiss"]))
    with Device(rays="query") as device, pytest.raises(SolariError, match=r"pass demo: .*rays='pipeline'"):
        Frame(device, [Stage("demo", buffers={"rays": 1, "found": 1}, passes=[SEVERAL])], glsl_root=root)

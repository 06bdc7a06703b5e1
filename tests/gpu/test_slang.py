"""Passes in Slang, and in SPIR-V that other compilers made, beside the same passes in GLSL."""

import tempfile

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.errors import CompilationError
from solari_vk.gpu.frame.frame import Frame
from solari_vk.gpu.frame.stages import RayPass
from solari_vk.gpu.shaders import foreign, slang
from solari_vk.gpu.shaders.compiler import compile_into_spirv
from solari_vk.gpu.shaders.shader_cache import Sources
from tests.gpu.shader_folder import check_spirv

needs_slang = pytest.mark.skipif(slang.library_file() is None, reason=f"needs {slang.INSTALL}")

DOUBLE = """#version 460
#extension GL_EXT_scalar_block_layout : require
layout(local_size_x = 64) in;
layout(constant_id = 3) const uint factor = 2u;
layout(set = 1, binding = 7, scalar) readonly buffer InputsBlock { uint at[]; } inputs;
layout(set = 1, binding = 9, scalar) buffer DoubledBlock { uint at[]; } doubled;
layout(set = 1, binding = 2, scalar) uniform SizesBlock { uint count; } sizes;
void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i < sizes.count) { doubled.at[i] = factor * inputs.at[i] + PLUS; }
}
"""
SLANG = """import helpers;
#include "offset.slangh"
struct Sizes { uint count; };
ConstantBuffer<Sizes> sizes;
StructuredBuffer<uint> doubled;
RWStructuredBuffer<float4> turned;
struct Turn { float4x4 matrix; float3x4 rows; };
ConstantBuffer<Turn> turn;
uniform float gain;
[format("r32f")] RWTexture2D<float> picture;
[vk::constant_id(5)] const int steps = 1;
[shader("compute")] [numthreads(8, 8, 1)]
void work(uint3 id : SV_DispatchThreadID)
{
    uint i = id.y * 8 + id.x;
    if (i >= sizes.count) return;
    float4 value = mul(turn.matrix, float4(1, 2, 3, OFFSET));
    value.xyz += mul(turn.rows, float4(1, 2, 3, 4));
    turned[i] = gain * helped(value) + doubled[i] + steps;
    picture[id.xy] = float(i);
}
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes/work.slang").write_text(SLANG)
    (tmp_path / "passes/helpers.slang").write_text("float4 helped(float4 value) { return 0.5 * value; }\n")
    (tmp_path / "passes/offset.slangh").write_text("#define OFFSET 4\n")
    return tmp_path


def spirv_of(plus=0, text=DOUBLE, stage="comp"):
    return compile_into_spirv(text.replace("PLUS", f"{plus}u"), stage, "double.comp", optimization="zero")


def doubles(device, folder, **options):
    """A frame of two passes of the same SPIR-V, the second of which reads what the first has written."""
    stage = sv.Stage("double", {"doubled": 100}, passes=[sv.Pass("double", threads=100, **options)])
    inputs = device.buffer(400, "inputs")
    inputs.upload(np.arange(100, dtype=np.uint32))
    frame = Frame(device, [stage], external={"inputs": inputs}, glsl_root=folder)
    frame.uniforms["sizes.count"] = 90
    return frame


# ---- SPIR-V ------------------------------------------------------------------------------------------


def test_a_pass_takes_spirv(bound_device, folder):
    """By its bytes, and from a file, which is read again; names, constants and robustness as of GLSL."""
    expected = np.where(np.arange(100) < 90, 2 * np.arange(100), 0)
    with doubles(bound_device, folder, spirv=bytearray(spirv_of())) as frame:
        frame.submit()
        np.testing.assert_array_equal(frame["doubled"], expected)
        assert [(row.reads, row.writes) for row in frame.describe()] == [(("inputs",), ("doubled",))]
        frame.uniforms["sizes.count"] = 1000
        frame.submit()
        np.testing.assert_array_equal(frame["doubled"], 2 * np.arange(100))
    file = folder / "passes/double.spv"
    file.write_bytes(spirv_of())
    with doubles(bound_device, folder, constants={"factor": 3}) as frame:
        frame.submit()
        np.testing.assert_array_equal(frame["doubled"][:90], 3 * np.arange(90))
        file.write_bytes(spirv_of(plus=5))
        frame.rebuild()
        frame.submit()
        np.testing.assert_array_equal(frame["doubled"][:90], 3 * np.arange(90) + 5)
        file.write_bytes(file.read_bytes()[:-8])
        with pytest.raises(
            sv.SolariError, match=r"passes/double\.spv: the SPIR-V module is cut off: its last function"
        ):
            frame.rebuild()
        frame.submit()
        np.testing.assert_array_equal(frame["doubled"][:90], 3 * np.arange(90) + 5)
    # Sources come before what was compiled from them.
    (folder / "passes/double.comp").write_text(DOUBLE.replace("PLUS", "7"))
    with doubles(bound_device, folder) as frame:
        frame.submit()
        assert frame["doubled"][1] == 9


def test_spirv_that_no_pass_can_run(device, folder):
    with pytest.raises(sv.SolariError, match="pass rays: spirv is of compute shaders: a RayPass names the files"):
        RayPass("rays", threads=1, spirv=spirv_of())
    vertex = spirv_of(text="#version 460\nvoid main() { gl_Position = vec4(0); }", stage="vert")
    pushed = DOUBLE.replace("layout(set = 1, binding = 2, scalar) uniform", "layout(push_constant) uniform")
    for spirv, message in (
        (b"\3\2\43\7", "passes/double: this is not a SPIR-V module"),
        (b"none", "passes/double: this is not a SPIR-V module"),
        (b"odd", "passes/double: SPIR-V is bytes, a multiple of 4, not b'odd'"),
        ("text", "passes/double: SPIR-V is bytes, a multiple of 4, not 'text'"),
        (spirv_of()[:20], "passes/double: the SPIR-V module has no entry point"),
        (spirv_of()[:-4], "passes/double: the SPIR-V module is cut off: its last function has no end"),
        (spirv_of()[:1000], "passes/double: the SPIR-V module is cut off"),
        (vertex, "passes/double: a pass runs one compute shader, and the entry points are main"),
        (spirv_of(text=pushed), "passes/double: frames set no push constants: declare a uniform block"),
    ):
        with pytest.raises(sv.SolariError, match=message):
            doubles(device, folder, spirv=spirv)
    for options in ({"spirv": spirv_of()}, {}):
        (folder / "passes/double.spv").write_bytes(spirv_of())
        with pytest.raises(sv.SolariError, match=r"double(\.spv)?: a header is text before a shader's own, and SPIR-V"):
            doubles(device, folder, header="#define A", **options)


# ---- Slang -------------------------------------------------------------------------------------------


@pytest.fixture
def frame(device, folder):
    """The second pass reads what the first has written."""
    passes = [sv.Pass("double", threads=64, spirv=spirv_of()), sv.Pass("work", threads=(8, 8), constants={"steps": 3})]
    buffers, images = {"doubled": 64, "turned": 64}, {"picture": (8, 8)}
    inputs = device.buffer(256, "inputs")
    inputs.upload(np.arange(64, dtype=np.uint32))
    stage = sv.Stage("work", buffers, images, passes)
    with Frame(device, [stage], external={"inputs": inputs}, glsl_root=folder) as made:
        yield made


@needs_slang
def test_slang_beside_spirv(frame, folder):
    """Blocks, numpy's matrices as they are, loose uniforms, constants, an image, an import, an include, a barrier."""
    matrix = np.arange(16, dtype=np.float32).reshape(4, 4)
    rows = np.linspace(1, 5, 12, dtype=np.float32).reshape(3, 4)
    frame.uniforms.update({"sizes.count": 60, "turn.matrix": matrix, "turn.rows": rows, "globalParams.gain": 8.0})
    frame.submit()
    vector = np.array([1, 2, 3, 4], np.float32)
    value = matrix @ vector + np.append(rows @ vector, 0)
    expected = np.where(np.arange(64)[:, None] < 60, 4 * value + 2 * np.arange(64)[:, None] + 3, 0)
    np.testing.assert_allclose(frame["turned"], expected, rtol=1e-6)
    np.testing.assert_array_equal(frame["picture"].ravel(), np.where(np.arange(64) < 60, np.arange(64), 0))
    assert frame.describe()[1].barrier.startswith("RAW doubled")
    (folder / "passes/helpers.slang").write_text("float4 helped(float4 value) { return 0.25 * value; }\n")
    frame.rebuild()
    frame.submit()
    np.testing.assert_allclose(frame["turned"][0], 2 * value + 3, rtol=1e-6)
    (folder / "passes/offset.slangh").write_text("#define OFFSET 0\n")
    frame.rebuild()
    frame.submit()
    np.testing.assert_allclose(frame["turned"][0], 2 * (value - 4 * matrix[:, 3]) + 3, rtol=1e-6)


@needs_slang
def test_mistakes_in_slang_are_named_with_file_and_line(frame, folder):
    work, helpers, offset, own = (
        folder / "passes" / name for name in ("work.slang", "helpers.slang", "offset.slangh", "own.glsl")
    )
    unmarked = SLANG.replace('[shader("compute")] [numthreads(8, 8, 1)]', "")
    start = '[shader("compute")] [numthreads(1, 1, 1)] void work() {'
    for file, text, message in (
        (work, SLANG.replace("gain *", "gane *"), r"passes/work\.slang:19: error: undefined identifier"),
        (helpers, "float4 helped(float4 v) { return; }", r"passes/helpers\.slang:1: error: "),
        (offset, "\n#define OFFSET four\n", r"passes/\w+\.slangh?:\d+: error: undefined identifier"),
        (own, "float broken() {\n return missing;\n}\n", r"passes/own\.glsl:2: error: undefined identifier"),
        (work, unmarked, r"work\.slang: error: there is no entry point: .shader"),
        (work, f"{start}}}\n{start.replace('work', 'more')}}}", r"one compute shader, and the .* are work, more"),
        (work, f"import nowhere;\n{SLANG}", r"passes/work\.slang:1: error: .*nowhere"),
    ):
        before = file.read_text() if file.exists() else ""
        file.write_text(text)
        if file == own:
            work.write_text(f'#include "passes/own.glsl"\n{SLANG}')
        with pytest.raises((CompilationError, sv.SolariError), match=message) as raised:
            frame.rebuild()
        assert f"{tempfile.gettempdir()}/tmp" not in str(raised.value)
        work.write_text(SLANG)
        file.write_text(before)
    frame.rebuild()
    frame.submit()


@needs_slang
def test_a_header_and_the_cache_on_disk(device, folder, monkeypatch, tmp_path):
    monkeypatch.setenv("SOLARI_VK_CACHE", str(tmp_path / "cache"))
    text = '[shader("compute")] [numthreads(1, 1, 1)] void main() { numbers[0] = VALUE; }'
    (folder / "passes/header.slang").write_text(f"RWStructuredBuffer<uint> numbers;\n{text}\n")

    def run(header):
        one = sv.Pass("header", threads=1, header=header)
        with Frame(device, [sv.Stage("one", {"numbers": 1}, passes=[one])], glsl_root=folder) as made:
            made.submit()
            return made["numbers"][0]

    assert (run("#define VALUE 3"), run("#define VALUE 4")) == (3, 4)
    with pytest.raises(CompilationError, match=r"header\.slang:2: error: undefined identifier"):
        run("#define OTHER 1")
    monkeypatch.setattr(slang, "_compile", lambda *_: pytest.fail("it is in the cache"))
    assert run("#define VALUE 3") == 3


@needs_slang
def test_files_that_are_included_from_anywhere_stay_as_they_are(device, folder):
    """Those above the root and those with absolute paths; what Slang reads of them is rewritten elsewhere."""
    root = folder / "deep/root"
    (root / "passes").mkdir(parents=True)
    base = "layout(constant_id = 7) const uint base = 3;\n"
    (folder / "above.glsl").write_text(f"{base}const uint twice = 2 * base;\n")
    (folder / "absolute.glsl").write_text("const uint forty = 40;\n#if 0\nconst uint never = 2 * base;\n#endif\n")
    (root / "passes/inner.glsl").write_text('#include "../../../above.glsl"\n')
    used = f'#include "passes/inner.glsl"\n#include "{(folder / "absolute.glsl").as_posix()}"\n'
    text = '[shader("compute")] [numthreads(1, 1, 1)] void main() { numbers[0] = base + forty + twice; }'
    (root / "passes/anywhere.slang").write_text(f"{used}RWStructuredBuffer<uint> numbers;\n{text}\n")
    before = {file: file.read_bytes() for file in folder.rglob("*.glsl")}
    stage = sv.Stage("one", {"numbers": 1}, passes=[sv.Pass("anywhere", threads=1)])
    with Frame(device, [stage], glsl_root=root) as made:
        made.submit()
        assert made["numbers"][0] == 49
    assert {file: file.read_bytes() for file in folder.rglob("*.glsl")} == before


@needs_slang
def test_imports_behind_others_and_comments_are_compiled_anew(device, folder):
    for number in range(4):
        (folder / f"passes/n{number}.slang").write_text(f"static const uint n{number} = 1;\n")
    (folder / "passes/n4.slangh").write_text("static const uint n4 = 1;\n")
    text = '[shader("compute")] [numthreads(1, 1, 1)] void main() { numbers[0] = n0 + n1 + n2 + n3 + n4; }'
    imports = "import n0; import n1; // one\nimport /* why */ n2;\n"
    (folder / "passes/all.slang").write_text(f"{imports}RWStructuredBuffer<uint> numbers;\n{text}\n")
    one = sv.Pass("all", threads=1, header='import n3;\n#include"n4.slangh"')
    with Frame(device, [sv.Stage("one", {"numbers": 1}, passes=[one])], glsl_root=folder) as made:
        for expected, name in enumerate(("", "n0.slang", "n1.slang", "n2.slang", "n3.slang", "n4.slangh"), 5):
            if name:
                file = folder / "passes" / name
                file.write_text(file.read_text().replace("= 1", "= 2"))
                made.rebuild()
            made.submit()
            assert made["numbers"][0] == expected, name


@needs_slang
def test_debug_information_stays_whole(device, folder, monkeypatch):
    monkeypatch.setattr(slang, "_OPTIONS", (*slang._OPTIONS, "-g2"))
    monkeypatch.setattr(slang.disk_cache, "load", lambda _: None)
    text = '[shader("compute")] [numthreads(1, 1, 1)] void main() { numbers[0] = 3; }'
    (folder / "passes/debug.slang").write_text(f"RWStructuredBuffer<uint> numbers;\n{text}\n")
    spirv = slang.compile_slang(Sources([folder]), "passes/debug.slang", "", ())
    assert b"NonSemantic." in spirv
    check_spirv(foreign.prepared(spirv, "debug"), "debug")


def test_without_the_compiler(device, folder, monkeypatch, tmp_path):
    monkeypatch.setattr(slang, "library_file", lambda: None)
    stage = sv.Stage("work", passes=[sv.Pass("work", threads=1)])
    with pytest.raises(
        sv.SolariError, match=r"work\.slang: Slang needs its compiler: pip install 'solari-vk\[slang\]'"
    ):
        Frame(device, [stage], glsl_root=folder)
    other = tmp_path / "libother.so"
    other.write_bytes(b"none")
    monkeypatch.setattr(slang, "library_file", lambda: other)
    with pytest.raises(sv.SolariError, match=r"the Slang compiler .*libother\.so can't be loaded .*pip install"):
        Frame(device, [stage], glsl_root=folder)


# ---- scenes ------------------------------------------------------------------------------------------

FOUND = """uint i = INDEX;
    if (i >= fan.count) { return; }
    uint rng = seed_rng(uvec2(i, 0), 0u, 7u);
    vec3 along;
    along.x = rand_f(rng); along.y = rand_f(rng); along.z = rand_f(rng);
    along = along * 2.0 - 1.0;
    Hit hit = trace_closest_hit(fan.origin, 0.0, along, 1e6, TRACE_BOTH_FACES, random_alpha_seed(rng));
    FOUND.t = hit.t;
    FOUND.instance = hit.instance;
    FOUND.passes = trace_visibility(fan.origin, along, 1.0) ? 1u : 0u;
    if (hit.instance == NO_INDEX) { return; }
    Mesh mesh = meshes.at[instances.at[hit.instance].ray_mesh];
    SurfaceInteraction surface = resolve_surface_interaction(hit, mesh, along, 0.01);
    FOUND.position = surface.world_position;
    FOUND.normal = surface.world_normal;
    FOUND.color = surface.material.base.color;
    FOUND.emissive = surface.material.emissive;
    vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
    FOUND.transmittance = trace_transmittance(origin, surface.geometric_world_normal, 2.0);"""
FIELDS = (
    "vec3 position; vec3 normal; vec3 color; vec3 emissive; vec3 transmittance; float t; uint instance; uint passes;"
)
INCLUDES = '#include "scene/trace.glsl"\n#include "scene/surface.glsl"\n'
IN_GLSL = (
    f"#version 460\n{INCLUDES}layout(local_size_x = 64) in;\n"
    "layout(set = 1, scalar) uniform FanBlock { vec3 origin; uint count; } fan;\n"
    f"struct Found {{ {FIELDS} }};\nlayout(set = 1, scalar) buffer FoundBlock {{ Found at[]; }} found;\n"
    f"void main() {{ {FOUND.replace('INDEX', 'INVOCATION_INDEX.x', 1).replace('FOUND', 'found.at[i]')} }}\n"
)
IN_SLANG = (
    f"{INCLUDES}struct Fan {{ float3 origin; uint count; }};\nConstantBuffer<Fan> fan;\n"
    f"struct Found {{ {FIELDS} }};\nRWStructuredBuffer<Found> found;\n"
    '[shader("compute")] [numthreads(64, 1, 1)]\nvoid main(uint3 id : SV_DispatchThreadID) {'
    f"{FOUND.replace('INDEX', 'id.x', 1).replace('FOUND', 'found[i]')} }}\n"
)


def many_kinds():
    """Blended, cut out, textured and mirrored surfaces and a second set of uvs in a box."""
    scene = sv.builtin("cornell_box")
    checks = np.tile(np.array([[[255, 60, 30, 255], [20, 200, 90, 60]]], np.uint8), (4, 2, 1))
    ball = sv.shapes.sphere(0.5, 8)
    ball.second_uvs = 2 * ball.uvs
    for number, mode in enumerate(("blend", "mask", "opaque")):
        texture = sv.Texture(checks, uv_set=number % 2, uv_transform=np.array([[2, 0.3, 0.1], [-0.3, 2, 0]]))
        material = sv.Material(alpha=0.8, alpha_mode=mode, base_color_texture=texture, double_sided=True)
        turn = np.diag([0.5, -0.5 if number == 1 else 0.5, 0.5, 1.0])
        turn[:3, 3] = 0.5 * number - 0.5, 0.8, 0.4
        scene.add(ball, material, turn)
    return scene


@needs_slang
def test_scenes_in_slang_are_those_in_glsl_bit_by_bit(device, folder):
    """Tables, hits, surfaces, random numbers and light that passes."""
    (folder / "passes/glsl.comp").write_text(IN_GLSL)
    (folder / "passes/in_slang.slang").write_text(IN_SLANG)
    for scene in (sv.builtin("cornell_box"), many_kinds()):
        found = {}
        for name in ("glsl", "in_slang"):
            stage = sv.Stage("trace", {"found": 4096}, passes=[sv.Pass(name, threads=4096)])
            with sv.SceneFrame(device, scene, [stage], glsl_root=folder) as frame:
                frame.uniforms.update({"fan.origin": (0, 1, 0), "fan.count": 4000})
                frame.submit()
                found[name] = frame["found"]
        first, other = found["glsl"], found["in_slang"]
        assert not [name for name in first.dtype.names if first[name].tobytes() != other[name].tobytes()]
        assert (first["instance"] < 100).mean() > 0.2
        assert 0 < first["passes"].mean() < 1


@needs_slang
def test_only_devices_with_ray_queries_trace_in_slang(any_device, folder):
    (folder / "passes/in_slang.slang").write_text(IN_SLANG)
    stage = sv.Stage("trace", {"found": 64}, passes=[sv.Pass("in_slang", threads=64)])
    message = r"in_slang\.slang: .* trace rays by queries: open the device with rays='query'"
    with sv.Device(rays="compute") as device, pytest.raises(sv.SolariError, match=message):
        sv.SceneFrame(device, sv.builtin("cornell_box"), [stage], glsl_root=folder)


@needs_slang
def test_a_stage_of_ones_own_in_slang(device, folder):
    text = """#include "passes/guides/bindings.glsl"
layout(set = 1, rgba16f) uniform image2D turned;
[shader("compute")] [numthreads(8, 8, 1)]
void main(uint3 id : SV_DispatchThreadID) {
    ivec2 at = ivec2(id.xy), size = imageSize(turned);
    if (at.x < size.x && at.y < size.y) imageStore(turned, at, abs(imageLoad(guides_normal_roughness, at)));
}
"""
    (folder / "passes/turn.slang").write_text(text)

    def turn(size):
        return sv.Stage("turn", images={"turned": size}, passes=[sv.Pass("turn", threads=size)], glsl_root=folder)

    with sv.Renderer(device, sv.builtin("cornell_box"), (24, 16)) as renderer:
        renderer.add_stage(turn, after="guides")
        frame = renderer.render()
        np.testing.assert_array_equal(frame["turned"], np.abs(frame["guides_normal_roughness"]))

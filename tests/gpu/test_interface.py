"""Bindings of several modules merged, descriptor sets written by name, and refused mistakes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.frame.descriptors import DescriptorSets
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
from solari_vk.gpu.frame.interface import Interface, merge_bindings, numbered
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import Module, reflect

SIZE = "layout(local_size_x = 1) in;\n"
VALUES = "layout(set = 1, binding = 0, scalar) buffer V { uint at[]; } values;\n"


def module(shaders, name: str, text: str) -> Module:
    shaders.write(name, SIZE + text)
    return reflect(compile_shader(f"passes/{name}.comp", root=shaders.root), name)


@pytest.mark.parametrize(
    ("other", "use", "message"),
    [
        (
            "layout(set = 1, binding = 0, scalar) buffer V { float at[]; } values;",
            "values.at[0] = 1.0;",
            r"values differs between one and two: element is uint32 and float32",
        ),
        (
            "layout(set = 1, binding = 0, r32ui) uniform uimage2D values;",
            "imageStore(values, ivec2(0), uvec4(0));",
            r"values differs between one and two: kind is storage_buffer and storage_image",
        ),
        (
            "layout(set = 0, scalar) buffer V { uint at[]; } values;",
            "values.at[0] = 1u;",
            r"values differs between one and two: set is 1 and 0",
        ),
        (
            "layout(set = 2, binding = 0, scalar) buffer W { uint at[]; } more;",
            "more.at[0] = 1u;",
            r"more of two is in set 2",
        ),
    ],
)
def test_conflicts_name_both_modules(shaders, other, use, message):
    one = module(shaders, "one", VALUES + "void main() { values.at[0] = 1u; }\n")
    two = module(shaders, "two", other + "void main() { " + use + " }\n")
    with pytest.raises(SolariError, match=message):
        merge_bindings([one, two])


BINDLESS = """#extension GL_EXT_nonuniform_qualifier : require
layout(set = 0, binding = 4) uniform sampler2D textures[];
layout(set = 1, binding = 0, scalar) buffer V { vec4 at[]; } values;
void main() {
    uint i = gl_GlobalInvocationID.x;
    values.at[i] = textureLod(textures[nonuniformEXT(i)], vec2(0.5), 0.0);
}
"""


def test_numbers_follow_from_names(shaders):
    """Declared numbers mean nothing: modules agree by names, and an array without a length comes last."""
    lone = "layout(set = 0, binding = 9, scalar) readonly buffer W { uint at[]; } lone;\n"
    first = module(shaders, "first", lone + VALUES + "void main() { values.at[0] = lone.at[0]; }\n")
    second = module(
        shaders,
        "second",
        BINDLESS.replace(" binding = 0,", "")
        .replace("set = 0, binding = 4", "set = 0")
        .replace("void main", "layout(set = 0, scalar) buffer X { uint at[]; } extra;\nvoid main")
        .replace("uint i =", "extra.at[0] = 1u; uint i =")
        .replace("vec4 at", "uint at")
        .replace("textureLod", "uint(textureLod")
        .replace("0.0);", "0.0).x);"),
    )
    merged = numbered(merge_bindings([first, second]))
    places = {name: (binding.set, binding.binding) for name, binding in merged.items()}
    assert places == {"lone": (0, 0), "values": (1, 0), "extra": (0, 1), "textures": (0, 2)}
    interface = SimpleNamespace(described=merged, device=SimpleNamespace(has_descriptor_indexing=True))
    linked = reflect(Interface.linked(interface, second))
    assert {name: found.binding for name, found in linked.bindings.items()} == {
        name: merged[name].binding for name in second.bindings
    }


def test_constants_get_ids_by_name(shaders):
    declared = "layout(constant_id = {0}_id) const uint {0} = {1}u;\n"
    shaders.write("passes/constants.glsl", declared.format("rows", 2))
    text = '#include "passes/constants.glsl"\n' + declared.format("columns", 3) + VALUES
    found = module(shaders, "both", text + "void main() { values.at[0] = rows * columns; }\n")
    assert {name: constant.default for name, constant in found.constants.items()} == {"rows": 2, "columns": 3}
    assert len({constant.id for constant in found.constants.values()}) == 2


def gray(device, level: int):
    image = device.image(2, 2, raw.VK_FORMAT_R8G8B8A8_UNORM, f"gray {level}")
    image.upload([np.full((2, 2, 4), level, np.uint8)])
    return image


def test_bindless_textures_grow_while_frames_run(device, shaders):
    shaders.write("look", SIZE + BINDLESS)
    sampler = device.sampler()
    images = [gray(device, level) for level in range(100)]
    few = [(image, sampler) for image in images[:3]]
    stages = [Stage("look", buffers={"values": 100}, passes=[Pass("look", threads=3)])]
    with Frame(device, stages, external={"textures": few}, glsl_root=shaders.root) as frame:
        frame.submit()
        np.testing.assert_allclose(frame["values"][:3, 0], np.arange(3) / 255, atol=1e-6)
        # The same number of textures, then many more, while both slots are in flight.
        frame.bind({"textures": few[::-1]})
        frame.submit()
        frame.submit()
        np.testing.assert_allclose(frame["values"][:3, 0], [2 / 255, 1 / 255, 0], atol=1e-6)
        frame.rebuild(
            [Stage("look", buffers={"values": 100}, passes=[Pass("look", threads=100)])],
            {"textures": [(image, sampler) for image in images]},
        )
        frame.submit()
        np.testing.assert_allclose(frame["values"][:, 0], np.arange(100) / 255, atol=1e-6)
    for image in images:
        image.destroy()


def test_bindless_array_must_be_the_only_one(device, shaders):
    more = "layout(set = 0) uniform sampler2D more[];\n"
    more += "void main() { values.at[1] = textureLod(more[uint(values.at[0].x)], vec2(0), 0.0);"
    found = module(shaders, "look", BINDLESS.replace("void main() {", more))
    with pytest.raises(SolariError, match=r"(textures|more): an array without a length must be .* the only one"):
        Interface(device, [found])


def test_wrong_resources_are_refused(device, shaders):
    declared = """
layout(set = 1, binding = 1, r32f) uniform image2D picture;
layout(set = 1, binding = 2) uniform sampler2D single;
layout(set = 1, binding = 3) uniform accelerationStructureEXT world;
void main() {
    rayQueryEXT q; rayQueryInitializeEXT(q, world, 0u, 255u, vec3(0), 0.0, vec3(1), 9.0);
    values.at[0] = uint(textureLod(single, vec2(0), 0.0).x) + uint(rayQueryProceedEXT(q));
    imageStore(picture, ivec2(0), vec4(0));
}
"""
    found = module(shaders, "all", "#extension GL_EXT_ray_query : require\n" + VALUES + declared)
    interface = Interface(device, [found])
    sets = DescriptorSets(interface, interface.bindless_counts({}))
    image = device.image(4, 4, raw.VK_FORMAT_R32_SFLOAT, "picture", usage=raw.VK_IMAGE_USAGE_STORAGE_BIT)
    buffer = device.buffer(64, "values")
    gone = device.buffer(64, "gone")
    gone.destroy()
    for resources, message in (
        ({"values": image}, "values is a storage_buffer and takes a Buffer, not <Image picture"),
        ({"picture": buffer}, "picture is a storage_image and takes a Image, not <Buffer values"),
        ({"single": image}, r"single takes an \(Image, Sampler\)"),
        ({"single": [(image, device.sampler())] * 2}, "single takes 1 resources, not 2"),
        ({"world": buffer}, "world takes an acceleration structure, a Tlas, not <Buffer"),
        ({"world": SimpleNamespace(handle=buffer.handle)}, "world takes an acceleration structure, a Tlas, not namesp"),
        ({"values": gone}, "values: <Buffer gone.* was destroyed"),
    ):
        with pytest.raises(SolariError, match=message):
            sets.write(resources)
    sets.write({"values": buffer, "picture": image, "unknown": SimpleNamespace()})
    with pytest.raises(SolariError, match="no shader has a resource nothing; there are picture, single, values"):
        interface["nothing"]
    for item in (sets, interface, image, buffer):
        item.destroy()


def test_buffer_beyond_what_shaders_can_see(device, shaders):
    limit = device.properties.limits.maxUniformBufferRange
    declared = VALUES + "layout(set = 1, binding = 1, scalar) uniform U { uint value; } u;\n"
    found = module(shaders, "u", declared + "void main() { values.at[0] = u.value; }\n")
    interface = Interface(device, [found])
    sets = DescriptorSets(interface, [0, 0])
    buffer = device.buffer(limit + 16, "large")
    with pytest.raises(SolariError, match=r"u has .* bytes, but this device's shaders see at most"):
        sets.write({"u": buffer})
    for item in (sets, interface, buffer):
        item.destroy()

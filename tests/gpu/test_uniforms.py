"""Uniform blocks: several in one array of bytes, fast writers, and values that are kept when the layout changes.

Writers pack plain numbers, with the same bytes as numpy.
"""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.base.errors import SolariError
from solari_vk.gpu.frame.frame import Frame, History, Pass, Stage
from solari_vk.gpu.frame.uniforms import Uniforms, packing

ONE = np.dtype([("scale", "f4"), ("place", "f4", (3,)), ("count", "u4")])
TWO = np.dtype([("count", "u4"), ("matrix", "f4", (4, 3))])


def make(**blocks: np.dtype) -> Uniforms:
    uniforms = Uniforms(64)
    uniforms.declare(blocks)
    return uniforms


def test_blocks_are_aligned_and_apart():
    uniforms = make(one=ONE, two=TWO)
    assert uniforms.offsets == {"one": 0, "two": 64}
    assert uniforms.memory.nbytes == 64 + TWO.itemsize
    uniforms["one.count"], uniforms["two.count"] = 5, 6
    uniforms["two.matrix"] = np.ones((4, 3))
    assert (uniforms["one.count"], uniforms["two.count"]) == (5, 6)
    assert uniforms.record("two")["matrix"].sum() == 12
    assert "one.count" in uniforms
    assert "one" in uniforms
    assert "count" not in uniforms


def test_unknown_names_and_wrong_shapes():
    uniforms = make(one=ONE)
    with pytest.raises(SolariError, match=r"no uniform 'two\.count'; did you mean 'one\.count'\? there are one\.scale"):
        uniforms["two.count"] = 1
    with pytest.raises(SolariError, match="no uniform block 'two'; there are one"):
        uniforms.record("two")
    with pytest.raises(SolariError, match=r"one\.place has shape \(3,\), not \(2,\)"):
        uniforms["one.place"] = (1, 2)
    with pytest.raises(SolariError, match=r"one\.count is uint32"):
        uniforms["one.count"] = -1
    with pytest.raises(SolariError, match=r"no uniform 'one\.cuont'; did you mean 'one\.count'"):
        uniforms.update({"one.count": 9, "one.cuont": 1})
    assert uniforms["one.count"] == 0, "nothing is set"
    uniforms.update_declared({"one.count": 9, "nobody.count": 1})
    assert uniforms["one.count"] == 9


def test_writers_and_values_outlast_another_layout():
    uniforms = make(one=ONE)
    there, absent = uniforms.writer("one", ("place", "count")), uniforms.writer("two", ("count",))
    there.write(1, 2, 3, 4)
    absent.write(7)
    assert (*uniforms["one.place"], uniforms["one.count"]) == (1, 2, 3, 4)
    before = uniforms.version
    uniforms.declare({"two": TWO, "one": ONE})
    assert uniforms.version > before
    assert (*uniforms["one.place"], uniforms["one.count"], uniforms["two.count"]) == (1, 2, 3, 4, 0)
    there.write(5, 6, 7, 8)
    absent.write(9)
    assert (*uniforms["one.place"], uniforms["one.count"], uniforms["two.count"]) == (5, 6, 7, 8, 9)
    uniforms.declare({"one": np.dtype([("count", "f4"), ("place", "f4", (3,))])})
    assert (*uniforms["one.place"], uniforms["one.count"]) == (5, 6, 7, 0), "count is of another type now"
    with pytest.raises(SolariError, match="without a gap"):
        there.write(1, 2, 3, 4)


BLOCKS = """struct Pair { uint first; uint second; };
layout(set = 0, binding = 3, scalar) uniform PairBlock { Pair pair; };
layout(set = 1, binding = 0, scalar) uniform ScaleBlock { uint factor; } scale;
layout(set = 1, binding = 1, scalar) uniform UnusedBlock { uint factor; } unused;
layout(set = 1, binding = 2, scalar) buffer ResultBlock { uint at[]; } result;
layout(local_size_x = 1) in;
uint sum(Pair p) { return p.first + p.second; }
void main() { result.at[0] = scale.factor * sum(pair); result.at[1] = pair.second; }
"""


def test_shaders_see_their_blocks_frame_by_frame(device, shaders):
    """A block without an instance name that holds one struct has the struct's name. Unread blocks are absent. A buffer
    of the caller can be a block."""
    shaders.write("blocks", BLOCKS)
    stage = Stage("blocks", buffers={"result": 2}, passes=[Pass("blocks", threads=1)])
    with Frame(device, [stage], glsl_root=shaders.root) as frame:
        assert "unused.factor" not in frame.uniforms
        pair = frame.uniforms.writer("pair", ("first", "second"))
        for number in range(3):
            frame.uniforms["scale.factor"] = 10 + number
            pair.write(number, 4)
            frame.submit()
            assert frame["result"].tolist() == [(10 + number) * (number + 4), 4]
    given = device.buffer(4, "given")
    given.upload(np.uint32(3))
    with Frame(device, [stage], external={"scale": given}, glsl_root=shaders.root) as frame:
        assert "scale" not in frame.uniforms
        frame.uniforms["pair.first"] = 2
        frame.submit()
        assert frame["result"].tolist() == [6, 0]
    given.destroy()


RECORD = np.dtype(
    {
        "names": ["matrix", "count", "place", "far", "address"],
        "formats": [("<f4", (4, 3)), "<u4", ("<f4", (2,)), "<i4", "<u8"],
        "offsets": [0, 48, 52, 64, 72],
        "itemsize": 80,
    }
)


def test_packs_as_numpy_does():
    packed, expected = np.zeros(1, RECORD), np.zeros(1, RECORD)
    matrix = np.random.default_rng(0).normal(size=(4, 3))
    expected["matrix"][0] = matrix
    expected["count"] = 2**32 - 1
    expected["place"][0] = (0.1, -2)
    expected["far"], expected["address"] = -5, 1 << 50
    for names, values in (
        (["matrix", "count"], [*matrix.ravel().tolist(), 2**32 - 1]),
        (["place"], [0.1, -2]),
        (["far"], [-5]),
        (["address"], [1 << 50]),
    ):
        fields, begin = packing(RECORD, names)
        fields.pack_into(packed.view(np.uint8).data, begin, *values)
    assert packed.tobytes() == expected.tobytes()


def test_fields_must_exist_and_follow_each_other():
    for names in (["matrix", "place"], ["place", "far"], ["far", "address"], ["count", "matrix"]):
        with pytest.raises(SolariError, match=f"field {names[1]} .* without a gap"):
            packing(RECORD, names)
    with pytest.raises(SolariError, match=r"no field near; there are matrix, count"):
        packing(RECORD, ["matrix", "near"])


FILLED = """
struct Ray { vec3 origin; uint id; };
layout(set = 1, scalar) buffer RaysBlock { Ray at[]; } rays;
layout(set = 1, scalar) buffer NumbersBlock { uint at[]; } numbers;
layout(set = 1, scalar) buffer PointsBlock { vec2 at[]; } points;
layout(set = 1, scalar) buffer TotalBlock { uint sum; float other; } total;
layout(set = 1, r8) uniform image2D picture;
layout(local_size_x = 1) in;
void main() {
    total.sum += rays.at[1].id + numbers.at[2] + uint(points.at[1].y);
    imageStore(picture, ivec2(0), vec4(1.0));
}
"""


def test_buffers_are_filled_by_name(device, shaders):
    shaders.write("fill", FILLED)
    buffers = {"rays": 2, "numbers": 4, "points": 2, "total": 1}
    stage = Stage("fill", buffers, {"picture": (1, 1)}, passes=[Pass("fill", threads=1)])
    with Frame(device, [stage], glsl_root=shaders.root) as frame:
        rays = np.zeros(2, frame.binding("rays").element)
        rays["id"] = 1, 2
        frame["rays"] = rays
        frame["numbers"] = [10, 20, 30]
        frame["points"] = np.array([[1, 2], [3, 4]])  # whole numbers of 64 bits
        frame["numbers"] = frame["points"] = []
        frame["total"] = np.array((100, 0.5), frame.binding("total").dtype)
        frame.submit()
        assert frame["total"]["sum"] == 100 + 2 + 30 + 4
        np.testing.assert_array_equal(frame["numbers"], [10, 20, 30, 0])
        for name, values, message in (
            (
                "numbers",
                np.zeros(3, np.float32),
                "numbers: the array is of float32, and the shader's elements are uint32",
            ),
            ("numbers", [-1], "numbers: the array has numbers beyond the range of the shader's elements, uint32"),
            ("numbers", np.zeros(5, np.uint32), r"numbers: the buffer has 4 elements, and the .* array is \(5,\)"),
            (
                "points",
                [[1e300, 0]],
                "points: the array has numbers beyond the range of the shader's elements, float32",
            ),
            ("numbers", 3, r"numbers: the buffer has 4 elements, and the shape of the array is \(\)"),
            ("points", np.zeros((2, 3)), r"points: the shape of the array is \(2, 3\); .* float32, \(2,\) each"),
            ("points", np.zeros((2, 2), complex), "points: the array is of complex128, and the shader's elements"),
            ("rays", np.zeros(2), "rays: the array is of float64, and the shader's elements are .*origin"),
            ("picture", np.zeros((1, 1)), "picture is a storage_image: only buffers can be filled"),
            ("nothing", [1], "the frame has no resource nothing; there are numbers, picture"),
        ):
            with pytest.raises(SolariError, match=message):
                frame[name] = values
        with pytest.raises(SolariError, match="total isn't an array"):
            frame._elements("total")


SUMMED = """
layout(set = 1, scalar) buffer SumsBlock { uint at[]; } sums;
layout(set = 1, scalar) buffer PreviousSumsBlock { uint at[]; } previous_sums;
layout(local_size_x = 1) in;
void main() { sums.at[0] = previous_sums.at[0] + 1u; }
"""


def test_a_history_is_filled_before_any_frame(device, shaders):
    shaders.write("sums", SUMMED)
    stage = Stage("sums", {"sums": History(1)}, passes=[Pass("sums", threads=1)])
    with Frame(device, [stage], glsl_root=shaders.root) as frame:
        assert frame.resource("previous_sums") is frame.resource("sums")
        for expected in (11, 21, 31):
            frame["sums"] = [expected - 1]
            assert frame["sums"] == expected - 1
            with pytest.raises(SolariError, match="previous_sums is what the frame before the latest made: fill sums"):
                frame["previous_sums"] = [1]
            frame.submit()
            assert frame["sums"] == expected

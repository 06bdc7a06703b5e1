"""Each claim runs at a tiny size, and verdicts follow from the measured numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.patches import patched_shaders

from solari_vk.cli import main
from solari_vk.errors import SolariError
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.measure.claims import older
from solari_vk.measure.claims.report import line, number, page
from solari_vk.measure.claims.run import CLAIMS
from solari_vk.measure.claims.specular import structural_error
from solari_vk.measure.claims.verdict import (
    RISES,
    Measure,
    Outcome,
    ends_below,
    falls,
    faster,
    grows_at_most,
    keeps,
    select,
)  # fmt: skip
from solari_vk.measure.claims.workbench import Variant, Workbench, grow
from solari_vk.measure.subjects import from_file, glowing
from solari_vk.scene.builtin import builtin


class Unpatched(Workbench):
    """Replaces patched shaders by the unpatched ones, so that the driver need not compile those of each patch."""

    def renderer(self, scene, size, patches=(), **settings):
        return super().renderer(scene, size, **settings)

    def reference(self, scene, size, samples, patches=(), **options):
        return super().reference(scene, size, samples, **options)


@pytest.fixture(scope="module", params=[Unpatched, pytest.param(Workbench, marks=pytest.mark.slow)])
def bench(device, request):
    return request.param(device, quick=True, say=lambda text: None)


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.name)
def test_claim_runs(bench, claim):
    """Each claim runs, with finite numbers, or `Measure` would refuse them. Its verdict means nothing at this size."""
    outcome = claim.measure(bench)
    assert outcome.untestable or any(measure.criterion is not None for measure in outcome.measures)
    for measure in outcome.measures:
        assert len(measure.before) == len(bench.seeds)
        assert line(measure)
    for _, caption, pixels in outcome.pictures:
        assert caption
        assert pixels.dtype == np.uint8
        assert pixels.ndim == 3
    otherwise = ("does not reproduce, because ", "cannot be tested here, because ")
    assert outcome.verdict.startswith("reproduces" if outcome.reproduces else otherwise)


def test_patches_are_glsl():
    """Shaders with all patches compile; a patch whose text isn't found raises an error."""
    every = [patch for name, patches in vars(older).items() if name.isupper() and name[0] != "_" for patch in patches]
    assert len(every) == 13
    with patched_shaders(*every):
        for name in ("restir_di/initial_and_temporal", "restir_di/spatial_and_shade", "world_cache/blend",
                     "world_cache/sample_indirect", "specular_gi/trace"):  # fmt: skip
            assert compile_shader(f"passes/{name}.comp")


def test_select():
    assert select(CLAIMS, []) == list(CLAIMS)
    assert [claim.name for claim in select(CLAIMS, ["layering", "di_order"])] == ["di_order", "layering"]
    with pytest.raises(SolariError, match="there is no claim 'tiles'; there are light_tiles"):
        select(CLAIMS, ["tiles"])


# ---- verdicts ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("criterion", "before", "after", "holds"), [
    (falls(2.0), [10, 11, 10], [4, 4, 4.2], True),
    (falls(2.0), [10, 11, 10], [6, 6, 6.2], False),
    (falls(2.0), [-0.5, -0.51, -0.5], [0.01, -0.02, 0.01], True),  # errors: signs don't count
    (falls(20.0), [300, 310, 305], [0, 0, 0], True),
    (falls(1.0), [1, 1, 1], [1, 1, 1], True),  # nothing scatters: what is not worse holds
    (falls(1.0), [1, 1, 1.1], [1.5, 1.4, 1.6], False),
    (faster(2.0), [10, 30, 20], [4, 11, 7.5], True),  # both of a pair slowed by what else runs
    (faster(2.0), [10, 30, 20], [6, 18, 12], False),
    (RISES, [0.95, 0.96, 0.95], [0.99, 1.0, 1.0], True),
    (RISES, [1.0, 1.0, 1.01], [0.9, 0.91, 0.9], False),
    (keeps(0.02), [1, 1.001, 0.999], [1.004, 1.003, 1.005], True),
    (keeps(0.02), [1, 1.001, 0.999], [0.95, 0.951, 0.952], False),
    (grows_at_most(2.0), [0.1, 0.11, 0.1], [0.15, 0.15, 0.16], True),
    (grows_at_most(2.0), [0.1, 0.11, 0.1], [0.35, 0.35, 0.36], False),
    (ends_below(0.02), [0.3, 0.3, 0.31], [-0.005, 0.004, 0.0], True),
    (ends_below(0.02), [0.3, 0.3, 0.31], [-0.2, -0.21, -0.2], False),
])  # fmt: skip
def test_criteria(criterion, before, after, holds):
    measure = Measure("it", "", before, after, criterion)
    assert (measure.failure() == "") == holds
    assert holds or (measure.failure().startswith("it goes from ") and measure.failure().endswith(criterion.text))


def test_noise_decides_nothing():
    """If the mean meets the criterion but its interval doesn't, the claim is not reproduced: it needs more runs."""
    measure = Measure("time", "ms", [10, 30, 20], [9, 10, 11], falls(1.5))
    assert measure.failure() == "time: the spread of 3 runs is too wide to tell"
    single = Measure("time", "ms", [30], [1], falls(1.5))
    assert "too wide" in single.failure()


def test_verdict_names_what_failed():
    good = Measure("error", "", [1, 1.1], [0.1, 0.1], falls(1.5))
    bad = Measure("time", "ms", [1, 1], [3, 3], falls(1.5))
    told = Measure("cells", "", [1, 1], [9, 9])
    assert Outcome([good, told]).verdict == "reproduces"
    outcome = Outcome([good, bad, told])
    assert not outcome.reproduces
    assert outcome.verdict == (
        "does not reproduce, because time goes from 1 to 3, where the claim asks that it falls at least 1.5 times"
    )
    assert Outcome([good], untestable="it is no light").verdict == "cannot be tested here, because it is no light"
    assert not Outcome([good], untestable="it is no light").reproduces


@pytest.mark.parametrize(
    ("before", "after"), [([1, math.nan], [1, 1]), ([1, 1], [1, math.inf]), ([1], [1, 2]), ([], [])]
)
def test_measure_refuses(before, after):
    with pytest.raises(ValueError, match="x: "):
        Measure("x", "", before, after)


def test_ratio():
    assert Measure("x", "", [6, 6], [-2, -2]).ratio == 3
    assert Measure("x", "", [6, 6], [0, 0]).ratio == math.inf
    assert Measure("x", "", [0, 0], [0, 0]).ratio == 1


# ---- what measures are made with --------------------------------------------------------------------


def test_grow():
    mask = np.zeros((5, 5), bool)
    mask[2, 2] = True
    assert grow(mask, 1).sum() == 5
    assert grow(mask, 2).sum() == 13


def test_structural_error_sees_through_noise():
    rng = np.random.default_rng(1)
    truth, mask = np.ones((64, 64, 3)), np.ones((64, 64), bool)
    noisy = truth + rng.normal(0, 0.2, truth.shape)
    assert structural_error(noisy, truth, mask) < 0.05
    assert structural_error(1.2 * truth, truth, mask) == pytest.approx(0.2)


def test_page(device):
    claim = CLAIMS[0]
    outcome = Outcome(
        [Measure("time", "ms", [2.0, 2.2], [1.0, 1.0], falls(1.5))],
        [("picture", "What it shows.", np.zeros((2, 2, 3), np.uint8))],
        note="A note.",
    )
    text = page([(claim, outcome)], device, "0.5", 2, "claims")
    assert f"| [{claim.name}](#{claim.name}) |" in text
    assert "| 2.10 ± 1.27 ms | 1.00 ± 0 ms | 2.10 |" in text
    assert "![What it shows.](claims/picture.png)" in text
    assert device.name in text
    assert claim.says in text
    assert "A note." in text


def test_number():
    assert [number(x) for x in (0, 1234.5, 12.345, 0.012345, -0.5, math.inf)] == [
        "0", "1,234", "12.3", "0.0123", "-0.500", "∞",
    ]  # fmt: skip


# ---- the command line and the frame's figures -------------------------------------------------------


def test_wrong_usage(any_device, tmp_path, capsys):
    assert main(["bench", "claims", "--only", "nothing"]) == 2
    assert "there is no claim 'nothing'" in capsys.readouterr().err
    assert main(["bench", "claims", "--markdown", str(tmp_path / "none" / "page.md")]) == 2
    assert main(["bench", "frame", str(tmp_path / "none.gltf")]) == 2
    assert main(["bench", "frame", str(tmp_path / "none.py:folder")]) == 2


def test_scene_of_a_script(tmp_path):
    (tmp_path / "made.py").write_text(
        "import solari_vk as sv\ndef made(path):\n    return sv.builtin('cornell_box', size=float(path.name))\n"
    )
    scene = from_file(tmp_path / "made.py:3.0")
    assert scene.name == "made"
    assert scene.bounds.max[1] == pytest.approx(3.0)


def test_glowing_keeps_its_geometry():
    totals = set()
    for count in (8, 500, 5000):
        counts = {item.material.name: len(item.mesh.triangles) for item in glowing(count, 1000)}
        totals.add(counts.pop("lamp") + counts.get("dark", 0))
    assert len(totals) == 1
    assert len(next(item.mesh.triangles for item in glowing(8, 1000) if item.material.name == "lamp")) == 8


def test_patches_hold_when_a_setting_rebuilds_the_frame(device):
    """Of two variants with the same setting, which is built into the shaders, the patched one has negative light."""
    shade = "di_diffuse.at[index] = diffuse;"
    patch = ("passes/restir_di/spatial_and_shade.comp", shade, shade.replace(" diffuse", " -diffuse"))
    changed = {"di_initial_visibility": False}
    variants = [Variant(changed), Variant(changed, (patch,))]
    scene = builtin("cornell_box")

    def measure(renderer):
        return renderer.render(scene.camera)["di_diffuse"].sum()

    plain, patched = Workbench(device, quick=True, say=str).compare(scene, (8, 8), variants, measure)
    assert plain.min() > 0
    assert patched.max() < 0

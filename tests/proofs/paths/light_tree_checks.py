"""The tree of lights: the probabilities of lights, and how close they are to the lights' shares of the light."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray
from support.statistics import chi_squared_p, standard_deviations

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, rgb

_PATHS = (SUITE, "Paths")
EQUAL = Rule("the probability of a light is the one with which a walk down the tree of lights ends there", *_PATHS)
SUM = Rule("at each point, the probabilities of all lights have the sum 1", *_PATHS)
OFTEN = Rule("lights of the tree are chosen as often as their probability says", *_PATHS)
CLOSE = Rule("lights are chosen nearly in proportion to power times cosine over squared distance", *_PATHS)
LAMPS, RECEIVERS, DRAWS = 150, 24, 8192
_MAX_Z = NormalDist().inv_cdf(0.9999)
Floats = NDArray[np.float64]


def lamps_in_space(random: np.random.Generator) -> sv.Scene:
    """Balls of light of many sizes and powers, in clusters, one of them much brighter than the rest; and a sun."""
    scene = sv.Scene(sv.DirectionalLight(direction=rgb((0, -1, 0)), illuminance=2.0))
    ball, middles = shapes.sphere(0.02, 6), random.uniform(-4, 4, (6, 3))
    for index in range(LAMPS):
        radiance = 30.0 if index == 7 else random.uniform(0.1, 2.0)
        at = middles[index % len(middles)] + random.normal(scale=0.4, size=3)
        scene.add(ball, lamp(radiance), tuple(at))
    return scene


def measure_tree(shaders: ShaderRunner) -> Iterator[Measurement]:
    """Measures draws and probabilities at random points."""
    random = np.random.default_rng(3)
    scene = lamps_in_space(random)
    receivers = np.zeros(RECEIVERS, shaders.element("test/light_tree", "receivers"))
    receivers["position"] = random.uniform(-5, 5, (RECEIVERS, 3))
    normals = random.normal(size=(RECEIVERS, 3)) - receivers["position"]  # most face lights
    receivers["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    binder = SceneBinder(shaders.device, scene)
    try:
        binder.update()
        lights = binder.lights
        shares = lights.sources.records["choice"]["probability"][: LAMPS + 1].astype(np.float64)
        outputs = {"drawn": RECEIVERS * DRAWS, "probabilities": RECEIVERS * (LAMPS + 1)}
        inputs = {**binder.resources, "receivers": receivers}
        found = shaders.run("test/light_tree", RECEIVERS * DRAWS, inputs, outputs)
        powers, positions = lights.powers[:LAMPS], lights.positions[:LAMPS]
    finally:
        shaders.device.wait_idle()
        binder.destroy()
    drawn = found["drawn"].reshape(RECEIVERS, DRAWS)
    probabilities = found["probabilities"].reshape(RECEIVERS, LAMPS + 1).astype(np.float64)
    expected = np.take_along_axis(probabilities, drawn["light"].astype(np.int64), axis=1)
    error = np.abs(drawn["probability"] / expected - 1).max()
    yield Measurement(EQUAL, float(np.nan_to_num(error, nan=np.inf)), 1e-5, "relative error")
    yield Measurement(SUM, float(np.abs(probabilities.sum(axis=1) - 1).max()), 1e-5, "absolute error")
    observed = np.stack([np.bincount(row, minlength=LAMPS + 1) for row in drawn["light"]])
    z = standard_deviations(chi_squared_p(observed.ravel(), DRAWS * probabilities.ravel()))
    yield Measurement(OFTEN, z, _MAX_Z, "standard deviations", f"{RECEIVERS} points")
    yield _measure_noise(receivers, positions, powers, probabilities[:, :LAMPS] / shares[:LAMPS].sum())


def _measure_noise(receivers: NDArray[Any], positions: Floats, powers: Floats, probabilities: Floats) -> Measurement:
    """The relative variance of one light sample's light without occlusion, as the mean over points."""
    to_light = positions - receivers["position"][:, None].astype(np.float64)
    squared = (to_light**2).sum(axis=-1)
    cosine = np.einsum("rlc,rc->rl", to_light, receivers["normal"]).clip(min=0) / np.sqrt(squared)
    light = powers * cosine / squared
    lit = light.sum(axis=1) > 0
    variance = (light[lit] ** 2 / probabilities[lit]).sum(axis=1) / light[lit].sum(axis=1) ** 2 - 1
    note = f"points from {variance.min():.2f} to {variance.max():.2f}"
    return Measurement(CLOSE, float(variance.mean()), 0.27, "of the squared mean", note)

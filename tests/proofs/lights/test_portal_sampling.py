"""Light samples of portals: directions by chi squared against their density, which follows the light behind them."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
from oracles.light import environment_radiance
from scipy import stats
from support.frames import bound_scene
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require, with_shaders
from support.statistics import standard_deviations

import solari_vk as sv
from solari_vk.bound.lights.light_leaves import PORTAL_SHARE
from solari_vk.scene.lights.environment import luminances
from solari_vk.scene.matrices import rotation

PORTALS = [
    ((0, 1, -2), (1, 0, 0), (0, 1, 0)),
    ((0.4, 1.2, -2), (0.8, 0, 0), (0, 0.7, 0)),  # two that overlap
    ((3, 0, 0), (0, 0.5, 0.3), (0.2, 0, 1)),
    ((0, 3, 0), (0.6, 0.2, 0), (0.4, 0, 0.5)),  # turned, and sheared
    ((-0.2, 0.3, 0), (0, 1, 0), (0, 0, 1)),  # close to the first receiver
]
RECEIVERS = [(0, 0, 0), (0.5, 2, -2.2), (40, 9, 30)]
DRAWS = 300_000
GRID = 256
CELLS = 16
_MAX_Z = NormalDist().inv_cdf(0.9999)
CHI_SQUARED = Rule("directions through portals have the density that they are given")
WHOLE = Rule("the density of directions through a portal integrates to the chance of the portal")
SAME = Rule("a sample's density is that of its direction")
INVERSE = Rule("the random numbers of a direction are those of its sample")
FOLLOWS = Rule("samples of a portal follow the light behind it")


def world():
    generator = np.random.default_rng(2)
    image = np.exp(1.5 * generator.normal(size=(48, 96, 3))).astype(np.float32)
    image[:24][generator.random((24, 96)) < 0.2] = 0
    image[10, 70] = 3e4  # a sun
    sky = sv.Environment(image, rotation=rotation((0.3, 1, 0.1), 2.0))
    return sv.Scene(sky, *(sv.Portal(*fields) for fields in PORTALS))


def measure_sampling(shaders):
    scene = world()
    with bound_scene(shaders.device, scene) as binder:
        for receiver in RECEIVERS:
            found = shaders.run(
                "test/portal_samples",
                max(DRAWS, len(PORTALS) * GRID**2),
                binder.resources | {"place": np.array([receiver], np.float32)},
                {"drawn": DRAWS, "chances": len(PORTALS) * GRID**2},
                constants={"SCENE_PORTAL": True, "SCENE_ENVIRONMENT": True},
            )
            yield from _judged(scene, np.array(receiver, float), found["drawn"], found["chances"])


def _p_value(counts, chances, variances, whole):
    """Of counts against chances that are known with variances, of which `whole` is the sum."""
    share, error = chances / whole, variances / whole**2
    rare = share * counts.sum() < 10
    counts, share, error = (np.append(v[~rare], v[rare].sum()) for v in (counts, share, error))
    total = counts.sum()
    squares = (counts / total - share) ** 2 / np.maximum(share / total + error, 1e-12)
    return float(stats.chi2.sf(squares.sum(), len(squares)))


def _judged(scene, receiver, drawn, chances):
    chances = chances.reshape(len(PORTALS), CELLS, GRID // CELLS, CELLS, -1).astype(np.float64)
    cells, variances = chances.sum(axis=(2, 4)), (GRID // CELLS) ** 2 * chances.var(axis=(2, 4))
    areas = np.array([light.area for light in scene.lights if isinstance(light, sv.Portal)])
    expected = PORTAL_SHARE * areas / areas.sum()
    yield Measurement(WHOLE, float(np.abs(cells.sum(axis=(1, 2)) / expected - 1).max()), 0.05)
    assert np.isfinite(drawn["pdf"]).all()
    apart = np.abs(drawn["density"] / drawn["pdf"] - 1)
    yield Measurement(SAME, float(np.quantile(apart, 0.999)), 2e-3, "at the borders of texels more")
    yield Measurement(INVERSE, float(np.quantile(np.abs(drawn["u"] - drawn["inverted"]), 0.999)), 2e-3)
    ratios = []
    for index, fields in enumerate(PORTALS):
        center, half_u, half_v = np.array(fields, float)
        directions = drawn["direction"][drawn["portal"] == index].astype(np.float64)
        normal = np.cross(half_u, half_v)
        places = receiver + directions * (((center - receiver) @ normal) / (directions @ normal))[:, None]
        along = np.linalg.lstsq(np.stack([half_u, half_v], axis=1), (places - center).T, rcond=None)[0]
        column, row = ((along / 2 + 0.5) * CELLS).clip(0, CELLS - 1).astype(int)
        counts = np.bincount(row * CELLS + column, minlength=CELLS**2)
        z = standard_deviations(_p_value(counts, cells[index].ravel(), variances[index].ravel(), expected[index]))
        yield Measurement(CHI_SQUARED, z, _MAX_Z, f"standard deviations, portal {index} from {receiver}")
        # the same for samples that are spread evenly over the portal
        grid = np.stack(np.meshgrid(*2 * [np.linspace(-0.99, 0.99, 100)]), axis=-1) @ np.stack([half_u, half_v])
        evenly = grid.reshape(-1, 3) + center - receiver
        solid_angles = np.abs(evenly @ normal) / np.linalg.norm(evenly, axis=1) ** 3
        noises = [
            _noise(scene, directions, 1 / drawn["pdf"][drawn["portal"] == index]),
            _noise(scene, evenly, solid_angles),
        ]
        ratios.append(noises[0] / noises[1])
    if not receiver.any():  # from elsewhere less of the sun is seen, or less of the map
        yield Measurement(FOLLOWS, float(np.mean(ratios)), 0.7, "of the noise of even samples")


def _noise(scene, directions, factors):
    seen = factors * luminances(environment_radiance(scene.environment, directions).astype(np.float32))
    return seen.std() / seen.mean()


def test_directions_have_their_density(shaders):
    require(measure_sampling(shaders))


SAMPLING, PORTAL = "scene/lights/portal_sampling.glsl", "scene/lights/portal.glsl"
_check = with_shaders(measure_sampling)
test_a_seeded_bug_is_noticed = bug_tests(
    {
        CHI_SQUARED: (
            _check,
            Bug(SAMPLING, "sample_column_or_row", "return correct(portal, window, first, last, weight, axis, u * u);"),
        ),
        WHOLE: (_check, Bug(SAMPLING, "texel_pdf", "return 0.8 * correct(rectangle, portal, window);")),
        SAME: (_check, Bug(SAMPLING, "texel_at", "return correct(portal, window, uv * uv);")),
        INVERSE: (_check, Bug(SAMPLING, "invert_window_sample", "return correct(portal, window, uv).yx;")),
        FOLLOWS: (
            _check,
            Bug(
                SAMPLING,
                "find_window",
                "MapWindow window = correct(portal, receiver); "
                "window.map_offset ^= (portal.map_size + 1u) * (portal.map_size + 1u); return window;",
            ),
        ),
    },
    quick=(CHI_SQUARED,),
)

"""`illuminance` against closed forms: derived after the cases of chapter 5 of CIE 171:2006, of which these are neither
copies nor a certificate. Luminaires are those of lights/test_profiles.py."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles.light import polygon_irradiance
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.renderers import illuminance
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box

BAR = 0.003  # beside four standard errors
NOISY = "5.6", "5.7", "5.9", "5.10", "5.11", "cylindrical, bulb"  # cases whose light is found by chance
UP, ACROSS = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
BLACK = {"base_color": 0.0, "specular": 0.0}
IOR = 1.5
GLASS = {"base_color": 1.0, "transmission": 1, "roughness": 0, "ior": IOR}
FLOOR = [(0, 0, 0), (0.7, 0, 0.4), (-1.5, 0, 1)]


def fresnel(cosine):
    """The share of unpolarized light that a boundary of glass reflects."""
    inside = np.sqrt(1 - (1 - cosine**2) / IOR**2)
    s, p = (cosine - IOR * inside) / (cosine + IOR * inside), (IOR * cosine - inside) / (IOR * cosine + inside)
    return (s**2 + p**2) / 2


def lit_by(light):
    return sv.Scene(light)


def from_point(points, normal, place, intensity):
    """Illuminance from a light at a place: I cos / d^2."""
    toward = np.subtract(place, points)
    return intensity * (toward @ np.asarray(normal)) / np.linalg.norm(toward, axis=1) ** 3


def lamp(corners, radiance):
    return sv.Instance(shapes.polygons(corners), sv.Material(**BLACK, emissive=radiance))


def rectangle(x, y, z):
    """The corners of a rectangle, one of whose ranges is a single number."""
    flat = next(i for i, range_ in enumerate((x, y, z)) if np.isscalar(range_))
    (a, b), (c, d) = (range_ for i, range_ in enumerate((x, y, z)) if i != flat)
    corners = [(a, c), (b, c), (b, d), (a, d)]  # faces down where flat is y
    return np.array([np.insert(corner, flat, (x, y, z)[flat]) for corner in map(np.array, corners)], np.float64)


OPENING = rectangle((-0.5, 1.5), 2.0, (-1, 1))
WINDOW = rectangle(2.0, (1, 2.5), (-1, 1))


def around(opening):
    """A large black plate around a rectangular opening, as four rectangles."""
    flat = int(np.argmin(np.ptp(opening, axis=0)))
    u, v = (axis for axis in range(3) if axis != flat)
    low, high = opening.min(axis=0), opening.max(axis=0)
    made = []
    for ranges in (
        ((-500, low[u]), (-500, 500)),
        ((high[u], 500), (-500, 500)),
        ((low[u], high[u]), (-500, low[v])),
        ((low[u], high[u]), (high[v], 500)),
    ):
        full = [low[flat]] * 3
        full[u], full[v] = ranges
        made.append(rectangle(*full))
    return sv.Instance(shapes.polygons(*made), sv.Material(**BLACK))


def daylight(opening):
    """Through an opening of a ceiling, or of a wall below one."""
    scene = sv.Scene(around(opening))
    if opening is WINDOW:
        scene.add(shapes.polygons(rectangle((-500, 2), 3.0, (-500, 500))), sv.Material(**BLACK))
    scene.environment = sv.Environment(100.0)
    return scene


def daylight_through_glass():
    """Through a pane in the opening of a ceiling, summed over parts of it; it mirrors a black ground, not the sky."""
    scene = daylight(OPENING)
    low, high = (OPENING.min(axis=0), OPENING.max(axis=0))
    parts = 256
    scene.add(shapes.polygons(OPENING), sv.Material(**GLASS))
    scene.add(shapes.polygons(rectangle((-500, 500), -0.1, (-500, 500))), sv.Material(**BLACK))
    middles = (np.arange(parts) + 0.5) / parts
    at = low + np.stack(np.meshgrid(middles, 0.0, middles), axis=-1).reshape(-1, 3) * (high - low)
    toward = at - np.array(FLOOR, np.float64)[:, None]
    squares = (toward**2).sum(axis=-1)
    cosine = toward[..., 1] / np.sqrt(squares)
    area = np.prod((high - low)[[0, 2]]) / len(at)
    return scene, FLOOR, UP, (100 * (1 - fresnel(cosine)) * cosine**2 / squares * area).sum(axis=1)


def sun_on_pane(degrees):
    angle = math.radians(degrees)
    scene = lit_by(sv.DirectionalLight((-math.sin(angle), -math.cos(angle), 0), illuminance=1000))
    scene.add(shapes.quad((0, 1, 0), (0, 0, 50), (50, 0, 0)), sv.Material(**GLASS))
    return scene, [(0, 0, 0)], UP, [1000 * math.cos(angle) * (1 - fresnel(math.cos(angle)))]


def from_floor(hidden=False):
    """A sunlit floor lights a wall that the sun doesn't reach; a plate hides the nearer half of the floor from it."""
    to_sun = np.array((-0.3, 1.0, 0))
    scene = lit_by(sv.DirectionalLight(-to_sun, illuminance=1000, angular_diameter=1e-3))
    patch = rectangle((0.2, 6), 0.0, (-4, 4))
    scene.add(shapes.polygons(patch[::-1]), sv.Material(base_color=0.6, specular=0))
    if hidden:
        scene.add(shapes.polygons(rectangle(0.5, (0, 0.75), (-9, 9))), sv.Material(**BLACK))
        patch = rectangle((2, 6), 0.0, (-4, 4))
    radiance = 0.6 * 1000 / np.linalg.norm(to_sun) / math.pi
    points = [(0, 1, 0)]
    return scene, points, ACROSS, polygon_irradiance(points, [ACROSS], patch, radiance)


BULB = sv.PointLight((0, 2, 0), intensity=300)
SPOT = {"direction": (0, -1, 0), "intensity": 300, "inner_cone_angle": 0.7, "outer_cone_angle": 0.8}
CEILING_LAMP = rectangle((-0.5, 0.5), 2.0, (-0.25, 0.75))
CASES = {
    "5.2 bulb over a floor": lambda: (lit_by(BULB), FLOOR, UP, from_point(FLOOR, UP, (0, 2, 0), 300)),
    "5.2 bulb beside a wall": lambda: (
        lit_by(BULB),
        [(-1, 0, 0), (-2, 3, 1)],
        ACROSS,
        from_point([(-1, 0, 0), (-2, 3, 1)], ACROSS, (0, 2, 0), 300),
    ),
    "5.2 spotlight": lambda: (
        lit_by(sv.SpotLight((0, 2, 0), **SPOT)),
        [(0, 0, 0), (1, 0, 0), (3, 0, 0)],
        UP,
        from_point([(0, 0, 0), (1, 0, 0), (3, 0, 0)], UP, (0, 2, 0), 300) * (1, 1, 0),
    ),
    "5.3 area light over a floor": lambda: (
        sv.Scene(lamp(CEILING_LAMP, 1000)),
        FLOOR,
        UP,
        polygon_irradiance(FLOOR, [UP], CEILING_LAMP, 1000),
    ),
    "5.3 area light beside a wall": lambda: (
        sv.Scene(lamp(CEILING_LAMP, 1000)),
        [(-1, 0.5, 0)],
        ACROSS,
        polygon_irradiance([(-1, 0.5, 0)], [ACROSS], CEILING_LAMP, 1000),
    ),
    "5.5 sun through a pane, 0": lambda: sun_on_pane(0),
    "5.5 sun through a pane, 60": lambda: sun_on_pane(60),
    "5.5 sun through a pane, 80": lambda: sun_on_pane(80),
    "5.6 reflected by a floor": from_floor,
    "5.7 behind a plate": lambda: from_floor(hidden=True),
    "5.8 closed cube": lambda: (
        white_cube(),
        [(0, -1, 0), (0.9, -1, 0.9), (0.3, 0.2, 0.1)],
        UP,
        np.full(3, math.pi / (1 - 0.6)),
    ),
    "5.9 sky through an opening of the roof": lambda: (
        daylight(OPENING),
        FLOOR,
        UP,
        polygon_irradiance(FLOOR, [UP], OPENING, 100),
    ),
    "5.10 sky through a pane of the roof": daylight_through_glass,
    "5.11 sky through a window": lambda: (
        daylight(WINDOW),
        [(0, 0.5, 0), (1, 1, 0.5)],
        UP,
        polygon_irradiance([(0, 0.5, 0), (1, 1, 0.5)], [UP], WINDOW, 100),
    ),
    "cylindrical, bulb": lambda: (
        lit_by(BULB),
        [(1, 0, 0), (0, 2, 3)],
        UP,
        300 / math.pi * np.array((1 / 5**1.5, 1 / 9)),
    ),
    "cylindrical, closed cube": lambda: (white_cube(), [(0.3, 0.2, 0.1)], (1, 2, 3), [math.pi / (1 - 0.6)]),
}


def white_cube():
    scene = closed_box(0.6, 1.0)
    scene.materials[0].specular = 0.0
    return scene


def measure_case(device, name):
    """The largest error beyond four standard errors, as a share of the largest illuminance."""
    scene, points, normal, expected = CASES[name]()
    samples = 2**17 if name.startswith(NOISY) else 2**13
    found = sv.illuminance(device, scene, points, normal, samples=samples, cylindrical=name.startswith("cylindrical"))
    scale = np.max(expected)
    beyond = np.maximum(np.abs(found.lux - expected) - 4 * found.standard_error, 0).max() / scale
    yield Measurement(Rule(f"illuminance, {name}", *SOURCE), float(beyond), BAR, "relative error")
    noise = float(found.standard_error.max() / scale)
    yield Measurement(Rule(f"standard error, {name}", *SOURCE), noise, 1e-2, "relative error")


SOURCE = ("derived after CIE 171:2006",)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name.startswith("5.10") else name for name in CASES]
)
def test_closed_forms(device, name):
    require(measure_case(device, name))


def test_flux_is_conserved(device):
    """5.4: black walls receive what a lamp emits."""
    middles = (np.arange(16) + 0.5) / 8 - 1
    u, v = (axis.ravel() for axis in np.meshgrid(middles, middles))
    points, normals = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            points.append(np.insert(np.stack([u, v], axis=1), axis, side, axis=1))
            normals.append(np.broadcast_to(-side * np.eye(3)[axis], points[-1].shape))
    scene = sv.Scene(lamp(rectangle((-0.5, 0.5), 0.5, (-0.25, 0.25)), 1000))
    found = sv.illuminance(device, scene, points, normals, samples=1024)
    assert found.lux.shape == (6, 256)
    assert found.lux.mean() * 24 == pytest.approx(math.pi * 1000 * 0.5, rel=BAR)


def test_standard_errors_are_those_of_the_noise(device):
    """Many points at one place differ by as much as each says, however many pixels a point has."""
    scene = sv.Scene(lamp(CEILING_LAMP, 1000))
    for count, samples in ((512, 64), (5000, 16)):
        found = sv.illuminance(device, scene, np.zeros((count, 3)), samples=samples, seed=3)
        assert found.lux.std() == pytest.approx(np.sqrt((found.standard_error**2).mean()), rel=0.15)
        expected = polygon_irradiance([(0, 0, 0)], [UP], CEILING_LAMP, 1000)[0]
        assert found.lux.mean() == pytest.approx(expected, abs=5 * found.lux.std() / count**0.5)
    assert sv.illuminance(device, scene, np.zeros((0, 3))).lux.shape == (0,)


def test_points_on_a_floor_see_what_is_above_it(device):
    """Also where the floor is far from the origin."""
    at = np.array((1000.0, 1000, 1000))
    scene = sv.Scene(sv.Instance(shapes.quad(at, (0, 0, 4), (4, 0, 0)), sv.Material(**BLACK)))
    scene.add(sv.DirectionalLight((0, -1, 0), illuminance=100))
    scene.environment = sv.Environment(100 / math.pi)
    points = at + np.random.default_rng(1).uniform(-3, 3, (64, 3)) * (1, 0, 1)
    assert sv.illuminance(device, scene, points, samples=512).lux == pytest.approx(np.full(64, 200), rel=0.1)


@pytest.mark.parametrize(
    ("points", "options", "said"),
    [
        ((0, 0), {}, r"the shape of points is \(2,\), not"),
        ((0, 0, math.nan), {}, "points must be finite"),
        ((0, 0, 0), {"normals": (0, 0, 0)}, "a normal has the length 0"),
        (np.zeros((2, 3)), {"normals": np.ones((3, 3))}, r"points \(2, 3\) and normals \(3, 3\) don't fit"),
        ((0, 0, 0), {"samples": 8}, "illuminance: samples is 8: give a whole number, at least 16"),
        ((0, 0, 0), {"cylindrical": 1}, "illuminance: cylindrical is 1"),
    ],
)
def test_wrong_arguments_are_errors(points, options, said):
    with pytest.raises(SolariError, match=said):
        sv.illuminance(None, sv.Scene(), points, **options)


def test_more_points_than_a_device_holds_are_refused(device, monkeypatch):
    limit = device.properties.limits.maxStorageBufferRange
    monkeypatch.setattr(illuminance._PointTracer, "LARGEST_PIXEL_BYTES", limit // 32)
    with pytest.raises(
        SolariError, match=r"illuminance: 99 points at once .* holds, which is 25: measure them in parts"
    ):
        sv.illuminance(device, sv.Scene(), np.zeros((99, 3)), samples=16)


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "lamps count twice": (
            lambda device: measure_case(device, "5.3 area light over a floor"),
            Bug("passes/reference/path.glsl", "mis_pdf", "return INFINITY;"),
        ),
        "2 % less light": (
            lambda device: measure_case(device, "5.2 bulb over a floor"),
            Bug(
                "passes/reference/illuminance.comp",
                "make_vertex",
                "Vertex vertex = correct(point, rng); vertex.brdf = lambert_brdf(vec3(0.98)); return vertex;",
            ),
        ),
    }
)

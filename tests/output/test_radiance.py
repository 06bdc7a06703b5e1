"""`illuminance` against Radiance, of the Python at SOLARI_VK_TRIAL_PYTHON, or of this one."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.lab.trial.process import Kind
from solari_vk.scene import shapes
from solari_vk.scene.lights.environment import directions
from tests.proofs.lights import test_profiles

PYTHON = os.environ.get("SOLARI_VK_TRIAL_PYTHON", sys.executable)


LUMENS_PER_WATT = 179.0  # Radiance's white light
SUN_DIAMETER = math.radians(0.533)
SKY = ("-ang", "40", "20", "-L", "30000", "15000", "-g", "0.2")  # the sun's height and direction, its lux and the sky's
GLOW = "\nskyfunc glow sky_glow 0 0 4 1 1 1 0\nsky_glow source sky 0 0 4 0 0 1 360\n"
ACCURACY = ("-ab", "12", "-aa", "0", "-ad", "8192", "-as", "0", "-lw", "1e-7", "-lr", "-12", "-dt", "0", "-dj", "0.9")
REPEATS = 8  # of each point, from which its standard error follows

# A room 4 m wide, 3 m high and 6 m deep, with a window 2.4 m wide and 1.5 m high to the south (+z).
REFLECTS = {"floor": 0.2, "ceiling": 0.7, "walls": 0.5}
SURFACES = {
    "floor": [[(-2, 0, 3), (2, 0, 3), (2, 0, -3), (-2, 0, -3)]],
    "ceiling": [[(-2, 3, -3), (2, 3, -3), (2, 3, 3), (-2, 3, 3)]],
    "walls": [
        [(-2, 0, -3), (2, 0, -3), (2, 3, -3), (-2, 3, -3)],
        [(-2, 0, 3), (-2, 0, -3), (-2, 3, -3), (-2, 3, 3)],
        [(2, 0, -3), (2, 0, 3), (2, 3, 3), (2, 3, -3)],
        [(-2, 0, 3), (-1.2, 0, 3), (-1.2, 3, 3), (-2, 3, 3)],
        [(1.2, 0, 3), (2, 0, 3), (2, 3, 3), (1.2, 3, 3)],
        [(-1.2, 0, 3), (1.2, 0, 3), (1.2, 1, 3), (-1.2, 1, 3)],
        [(-1.2, 2.5, 3), (1.2, 2.5, 3), (1.2, 3, 3), (-1.2, 3, 3)],
    ],
}
POINTS = {
    "work plane, 0.5 m from the window": ((0, 0.8, 2.5), (0, 1, 0)),
    "work plane, 2 m": ((0, 0.8, 1), (0, 1, 0)),
    "work plane, 4 m": ((1, 0.8, -1), (0, 1, 0)),
    "work plane, 5.5 m": ((-1, 0.8, -2.5), (0, 1, 0)),
    "floor in the sun": ((0.2, 0.01, 1.2), (0, 1, 0)),
    "back wall": ((0.5, 1.5, -2.99), (0, 0, 1)),
    "west wall": ((-1.99, 1.5, 0), (1, 0, 0)),
    "ceiling": ((0, 2.99, 0), (0, -1, 0)),
}


def package(python):
    """The folder of pyradiance, which another Python has."""
    look = "import importlib.util as u; print(u.find_spec('pyradiance').submodule_search_locations[0])"
    return Path(subprocess.run([python, "-c", look], capture_output=True, text=True, check=True).stdout.strip())


def run_radiance(root, *command, given=b"", folder=None):
    """What a program of Radiance prints."""
    paths = {"PATH": f"{root / 'bin'}{os.pathsep}{os.environ['PATH']}", "RAYPATH": f".{os.pathsep}{root / 'lib'}"}
    return subprocess.run(
        command, input=given, capture_output=True, check=True, cwd=folder, env=os.environ | paths
    ).stdout


def its_axes(vectors):
    """x, y up, z to the south as x, y to the north, z up."""
    x, y, z = np.moveaxis(np.asarray(vectors, np.float32), -1, 0)
    return np.stack([x, -z, y], axis=-1)


def rtrace(root, octree, origins, toward, *options, folder=None):
    rays = np.ascontiguousarray(np.concatenate([its_axes(origins), its_axes(toward)], axis=-1), np.float32)
    found = run_radiance(root, "rtrace", "-h", "-fff", "-w", *options, str(octree), given=rays.tobytes(), folder=folder)
    return LUMENS_PER_WATT * np.frombuffer(found, np.float32).reshape(-1, 3)[:, 1].astype(np.float64)


def compare_room(device, python, folder, samples=2**18):
    """Illuminances at POINTS in lux: ours, its standard error, and the same of Radiance, each (N,)."""
    root = package(python)
    sky = run_radiance(root, "gendaylit", *SKY).decode()
    words = sky.split()
    sun_radiance = float(words[words.index("light") + 4 + 1])
    to_sun = [float(word) for word in words[words.index("sun") + 4 :][:3]]
    bare = sky[: sky.index("void light")] + sky[sky.index("void brightfunc") :]
    room = "".join(
        f"\nvoid plastic {name} 0 0 5 {share} {share} {share} 0 0\n"
        + "".join(
            f"{name} polygon {name}{i} 0 0 12 {' '.join(map(str, its_axes(corners).ravel()))}\n"
            for i, corners in enumerate(SURFACES[name])
        )
        for name, share in REFLECTS.items()
    )
    for name, text in (("sky", bare + GLOW), ("room", sky + GLOW + room)):
        (folder / f"{name}.rad").write_text(text)
        (folder / f"{name}.oct").write_bytes(run_radiance(root, "oconv", str(folder / f"{name}.rad")))

    toward = directions(256, 512).reshape(-1, 3)
    texels = rtrace(root, folder / "sky.oct", np.zeros_like(toward), toward).reshape(256, 512)
    points, normals = (np.array(vectors, np.float64) for vectors in zip(*POINTS.values(), strict=True))
    repeated = (np.repeat(array, REPEATS, axis=0) for array in (points, normals))
    theirs = rtrace(root, folder / "room.oct", *repeated, "-I+", "-u+", *ACCURACY).reshape(-1, REPEATS)

    scene = sv.Scene()
    for name, share in REFLECTS.items():
        scene.add(shapes.polygons(*SURFACES[name]), sv.Material(base_color=share, specular=0))
    scene.environment = sv.Environment(texels)
    illuminance = LUMENS_PER_WATT * sun_radiance * math.pi * math.sin(SUN_DIAMETER / 2) ** 2
    direction = np.array((-to_sun[0], -to_sun[2], to_sun[1]))
    scene.add(sv.DirectionalLight(direction, illuminance=illuminance, angular_diameter=SUN_DIAMETER))
    ours = sv.illuminance(device, scene, points, normals, samples=samples)
    return ours.lux, ours.standard_error, theirs.mean(axis=1), theirs.std(axis=1, ddof=1) / REPEATS**0.5


def markdown_table(ours, our_error, theirs, their_error):
    """The comparison as a markdown_table in Markdown."""
    rows = ["| point | solari_vk, lux | Radiance, lux | ratio |", "| --- | --- | --- | --- |"]
    for name, a, b, c, d in zip(POINTS, ours, our_error, theirs, their_error, strict=True):
        error = a / c * math.hypot(b / a, d / c)
        rows.append(f"| {name} | {a:,.1f} ± {b:.1f} | {c:,.1f} ± {d:.1f} | {a / c:.4f} ± {error:.4f} |")
    return "\n".join(rows)


def luminaire(device, python, file, points, **turned):
    """Illuminances in lux on surfaces at points (N, 3) that face a luminaire in the origin: ours, which may be turned,
    and theirs."""
    root = package(python)
    folder = file.parent
    scene = file.with_suffix("")
    run_radiance(root, "ies2rad", "-t", "white", "-dm", "-o", str(scene), str(file))
    (folder / "luminaire.oct").write_bytes(run_radiance(root, "oconv", str(scene.with_suffix(".rad")), folder=folder))
    normals = -points / np.linalg.norm(points, axis=1)[:, None]
    theirs = rtrace(root, "luminaire.oct", points, normals, "-I", "-ab", "0", "-dj", "0", "-dt", "0", folder=folder)
    ours = sv.illuminance(device, sv.Scene(sv.PointLight((0, 0, 0), ies=file, **turned)), points, normals, samples=16)
    return ours.lux, theirs


@pytest.fixture
def python():
    """The Python that has Radiance."""
    why = Kind("Radiance", "", "pyradiance").missing(PYTHON)
    if why:
        pytest.skip(f"Radiance: {why}")
    return PYTHON


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in test_profiles.KINDS if kind.startswith("C")])
def test_luminaires(device, python, tmp_path, kind):
    """300 points around each. Radiance turns those with angles from 90 to 270 degrees by half a turn. It doesn't read
    type A, nor, off the two main planes, type B as photometry has it."""
    turned = {"horizontal": (-1, 0, 0)} if kind == "C, the other half" else {}
    (tmp_path / "lamp.ies").write_text(test_profiles.make_file(kind).replace(".1,.1 0", "0 0 0"))
    rng = np.random.default_rng(5)
    away = rng.normal(size=(300, 3))
    points = away * (rng.uniform(2, 6, 300) / np.linalg.norm(away, axis=1))[:, None]
    ours, theirs = luminaire(device, python, tmp_path / "lamp.ies", points, **turned)
    print(f"{kind}: {np.median(ours[theirs > 0.1] / theirs[theirs > 0.1]):.4f}, {np.abs(ours - theirs).max():.3f} lux")
    np.testing.assert_allclose(ours, theirs, rtol=0.002, atol=0.2)


@pytest.mark.slow
def test_a_room_under_a_perez_sky(device, python, tmp_path):
    """Sun, sky and ground through a window, and up to 16 reflections: within 2 % at each point, 1 % on average."""
    found = compare_room(device, python, tmp_path)
    print(markdown_table(*found))
    ours, our_error, theirs, their_error = found
    assert (our_error < 0.01 * ours).all()
    assert (their_error < 0.01 * theirs).all()
    assert ours == pytest.approx(theirs, rel=0.02)
    assert np.mean(ours / theirs) == pytest.approx(1, abs=0.01)

"""`solari-vk bench robots`: views a second of a robot in many worlds, beside MuJoCo Warp's renderer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from importlib import util
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.figures import Work, seconds, warm
from solari_vk.lab.measure.report import measuring

ROUNDS = 7
STATES = 4  # which frames show in turn
SAMPLES = 4
RENDERERS = ("labels", "realtime", "reference")
SHADOWS = (False, True)
INTRO = (
    "Views a second of a robot with four legs, a floor with a checker, painted parts and two lights, each view in a "
    f"world of its own, whose joints and camera move in each frame: the median of {ROUNDS} rounds, in turns, each "
    "until results are tensors on the device. Labels are depth and numbers of instances; realtime is the denoised "
    f"radiance, reference that of {SAMPLES} samples a pixel. MuJoCo Warp's renderer shows the same worlds in the same "
    "run: colors by its own light, without bounces, with textures, and hard shadows where it says so; its rows "
    "include the update of its trees.",
)
HEAD = ("renderer", "views/s", "ms a frame")

_LEG = """<body name="thigh{0}" pos="{1} {2} 0"><joint name="hip{0}" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 {3} -.2" size=".04" material="paint"/>
  <body name="shin{0}" pos="0 {3} -.2"><joint name="knee{0}" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .05 0 -.25" size=".03" material="steel"/>
    <geom type="sphere" pos=".05 0 -.25" size=".045" rgba=".1 .1 .1 1"/></body></body>"""
_PLACES = ((0.25, 0.12, 0.05), (0.25, -0.12, -0.05), (-0.25, 0.12, 0.05), (-0.25, -0.12, -0.05))
MODEL = f"""<mujoco model="four legs">
  <visual><headlight ambient=".2 .2 .2" diffuse=".2 .2 .2"/></visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1=".5 .6 .8" rgb2=".2 .2 .25" width="64" height="384"/>
    <texture name="tiles" type="2d" builtin="checker" width="128" height="128" rgb1=".25 .3 .35" rgb2=".6 .6 .55"/>
    <texture name="paint" type="cube" builtin="gradient" rgb1=".9 .4 .1" rgb2=".4 .1 .05" width="64" height="384"
      mark="cross" markrgb="1 1 1"/>
    <material name="tiles" texture="tiles" texrepeat="4 4" texuniform="true" reflectance=".1"/>
    <material name="paint" texture="paint" specular=".6" shininess=".6"/>
    <material name="steel" rgba=".6 .6 .65 1" specular=".9" shininess=".8"/>
  </asset>
  <worldbody>
    <light pos="1 -1 3" dir="-.3 .3 -1" diffuse=".6 .6 .6" cutoff="60"/>
    <light type="directional" dir=".4 .5 -1" diffuse=".4 .4 .4"/>
    <geom name="floor" type="plane" size="6 6 .1" material="tiles"/>
    <geom name="step" type="box" size=".3 .5 .08" pos="1 .4 .08" rgba=".3 .4 .3 1"/>
    <body name="trunk" pos="0 0 .5"><freejoint/>
      <geom type="box" size=".3 .12 .08" material="paint"/>
      <geom type="ellipsoid" size=".1 .08 .07" pos=".36 0 .04" material="steel"/>
      <camera name="behind" pos="-1.3 -.9 .7" xyaxes=".56 -.83 0 .32 .22 .92" fovy="50"/>
      {"".join(_LEG.format(number, *place) for number, place in enumerate(_PLACES))}
    </body>
  </worldbody>
</mujoco>"""


def run(
    select: str | None,
    worlds: int,
    size: tuple[int, int],
    markdown: Path | None,
    *,
    rays: str | None = None,
    renderers: Sequence[str] = (),
    samples: int = SAMPLES,
) -> None:
    """Measure and report. worlds: of each batch, one view each. size: of a view. renderers: all, if there are none.
    Raises SolariError for an unknown renderer, and without MuJoCo."""
    for name in renderers:
        if name not in RENDERERS:
            raise SolariError(f"bench robots: there is no renderer '{name}': give some of {', '.join(RENDERERS)}")
    with measuring(select, rays, markdown, "Robots", *INTRO) as (device, report), ExitStack() as closing:
        model, positions = _states(worlds)
        frames = _arrays(model, positions)
        works: dict[str, Work] = {}
        for name in renderers or RENDERERS:
            report.progress(f"{name}, {worlds} worlds")
            batch, work = _ours(device, model, worlds, frames, size, name, samples)
            closing.enter_context(batch)
            warm(device, work, 3, 0.5)
            works[name] = work
        notes = []
        try:
            for name, work in _by_warp(model, positions, size):
                report.progress(name)
                work()
                works[name] = work
        except (ImportError, SolariError) as error:
            notes.append(f"MuJoCo Warp's renderer didn't run: {error}")
        rounds = [[seconds(work) for work in works.values()] for _ in range(ROUNDS)]
        middle = np.median(rounds, axis=0)
        rows = [(name, f"{worlds / time:,.0f}", f"{1e3 * time:,.2f}") for name, time in zip(works, middle, strict=True)]
        report.table(f"{worlds:,} worlds, views of {size[0]}x{size[1]}", HEAD, rows, *notes)


def _states(worlds: int) -> tuple[Any, NDArray[np.float64]]:
    """The model, and positions (STATES, worlds, nq) of its joints, which go on from frame to frame."""
    from solari_vk.scene.files.mujoco.model_scene import import_mujoco

    mujoco = import_mujoco("bench robots")
    model = mujoco.MjModel.from_xml_string(MODEL)
    rng = np.random.default_rng(1)
    positions = np.tile(mujoco.MjData(model).qpos, (STATES, worlds, 1))
    positions[..., :2] += rng.uniform(-1, 1, (worlds, 2))
    positions[..., 7:] += rng.uniform(-0.6, 0.6, (worlds, model.nq - 7))
    positions[..., 7:] += 0.05 * np.arange(STATES)[:, None, None]
    return model, positions


def _arrays(model: Any, positions: NDArray[np.float64]) -> list[dict[str, Any]]:
    """The poses of each frame, on the GPU where Warp has one."""
    from solari_vk.scene.files.mujoco.model_scene import import_mujoco

    mujoco = import_mujoco("bench robots")
    data = mujoco.MjData(model)
    found: list[dict[str, Any]] = []
    for states in positions:
        frame: dict[str, list[Any]] = {f"{kind}_{what}": [] for kind in ("geom", "cam") for what in ("xpos", "xmat")}
        for state in states:
            data.qpos[:] = state
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            for name, values in frame.items():
                values.append(getattr(data, name).copy())
        found.append({name: np.array(values, np.float32) for name, values in frame.items()})
    if util.find_spec("warp") is None:
        return found
    import warp as wp

    if not wp.is_cuda_available():
        return found
    kinds = {"xpos": wp.vec3f, "xmat": wp.mat33f}
    shapes = {"xpos": (3,), "xmat": (3, 3)}
    return [
        {
            name: wp.array(values.reshape(*values.shape[:2], *shapes[name[-4:]]), dtype=kinds[name[-4:]], device="cuda")
            for name, values in frame.items()
        }
        for frame in found
    ]


def _ours(
    device: Device,
    model: Any,
    worlds: int,
    frames: Sequence[dict[str, Any]],
    size: tuple[int, int],
    name: str,
    samples: int,
) -> tuple[Any, Work]:
    outputs = ("depth", "instance_id") if name == "labels" else ()
    options: dict[str, Any] = {"renderer": name, "outputs": outputs, "device": device}
    batch = sv.mujoco.Batch(model, worlds, size[1], size[0], **options)
    results = outputs or ("radiance",)
    count = {"samples": samples} if name == "reference" else {}
    next_frames = cycle(frames)

    def work() -> None:
        batch.render(next(next_frames), **count)
        for result in results:
            batch.tensor(result)
        device.wait_idle()

    return batch, work


def _by_warp(model: Any, positions: NDArray[np.float64], size: tuple[int, int]) -> Iterator[tuple[str, Work]]:
    """MuJoCo Warp's renderer of the same worlds."""
    import mujoco_warp as mjw
    import warp as wp

    from solari_vk.scene.files.mujoco.model_scene import import_mujoco

    mujoco = import_mujoco("bench robots")
    wp.config.quiet = True
    where = "cuda" if wp.is_cuda_available() else "cpu"
    worlds = positions.shape[1]
    with wp.ScopedDevice(where):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        warp_model = mjw.put_model(model)
        frames = []
        for states in positions:
            of_frame = mjw.put_data(model, data, nworld=worlds)
            of_frame.qpos.assign(states.astype(np.float32))
            for step in (mjw.kinematics, mjw.com_pos, mjw.camlight):
                step(warp_model, of_frame)
            frames.append(of_frame)
        for shadows in SHADOWS:
            options = {"cam_res": size, "render_rgb": True, "render_depth": True, "use_shadows": shadows}
            context = mjw.create_render_context(model, nworld=worlds, render_skybox=True, **options)
            color = wp.zeros((worlds, size[1], size[0]), dtype=wp.vec3)
            number = 0

            def work(context: Any = context, color: Any = color) -> None:
                nonlocal number
                number += 1
                with wp.ScopedDevice(where):
                    state = frames[number % len(frames)]
                    mjw.refit_bvh(warp_model, state, context)
                    mjw.render(warp_model, state, context)
                    mjw.get_rgb(context, 0, color)
                    wp.synchronize()

            yield f"MuJoCo Warp on {where}, {'hard' if shadows else 'no'} shadows", work

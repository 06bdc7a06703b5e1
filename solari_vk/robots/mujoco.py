"""`sv.mujoco`: models of MuJoCo as scenes, a renderer with the interface of `mujoco.Renderer`, and batches of worlds.

The library itself is `import mujoco`, as ever.
"""

from __future__ import annotations

from typing import Any

from solari_vk.base.errors import checked_keywords
from solari_vk.robots.mujoco_batch import Batch
from solari_vk.robots.mujoco_renderer import Renderer
from solari_vk.scene.files.mujoco.model_scene import model_scene
from solari_vk.scene.model import Scene

__all__ = ["Batch", "Renderer", "scene"]


@checked_keywords(who="solari_vk.mujoco")
def scene(model: Any, data: Any = None) -> Scene:
    """The Scene of an MjModel in a state, MjData after `mj_forward`; by default the initial one.

    It is what `sv.load` makes of a file: an instance for each geom that MuJoCo shows, named as the geom, a Group for
    each body and joint, lights, cameras, and classes for labels. Raises SolariError for a state that isn't finite.
    """
    return model_scene(model, data).scene

"""What surrounds a scene: its own environment or another one, and light for files that have none."""

from __future__ import annotations

import math

import numpy as np

from solari_vk.scene.emission import mean_emission
from solari_vk.scene.lights.environment import Environment
from solari_vk.scene.lights.sky import Sky
from solari_vk.scene.material import UNLIT_RADIANCE
from solari_vk.scene.model import Camera, Instance, Scene
from solari_vk.scene.presenting.enclosures import extent, find_dome, find_room, place_of
from solari_vk.scene.presenting.studio_lights import add_floor, add_lamp, heading, studio_lights

# In cd/m^2, of emissive surfaces that light a scene: a tenth of the studio's walls, or a fifth if none is brighter than
# white paper there. Weaker ones are signs, screens and labels.
LEAST_EMISSION, LEAST_OF_PAPER = 0.04, 0.08
SUN_HEADING = math.radians(-50)  # from the camera's heading
SUN_HEIGHT = math.radians(40)  # above the horizon


def surround(scene: Scene, camera: Camera, kind: str) -> tuple[str, bool]:
    """Surround a scene by "studio", "sky", "none" or a picture in a file; "auto" keeps what the scene has, and gives a
    scene without light a studio, or a lamp if it is a closed room, or if the camera is in a dome or a closed shell.

    camera: what turns with it. Returns what the scene got for want of light, "" if it has some, and whether a studio
    alone lights it, which suits EV100 0.
    """
    lit = any(light.emits for light in scene.lights) or _is_lit_by_surfaces(scene)
    remedy = ""
    if kind == "auto" and not lit:
        visible = [instance for instance in scene if instance.visible]
        kind, remedy = _light_within(scene, visible, camera) if visible else ("studio", "shown in a studio")
    match kind:
        case "auto":
            pass
        case "none":
            scene.environment = None
        case "studio":
            studio_lights(scene, camera=camera, ground=not lit)
        case "sky":
            _add_sky(scene, camera, lit)
        case _:
            scene.environment = Environment(kind)
    return remedy, kind == "studio" and not lit


def _is_lit_by_surfaces(scene: Scene) -> bool:
    # A lamp is brighter than paper in the studio; a screen or label isn't, and must be larger to count as light.
    brightest = max((float(instance.material.emissive.max()) for instance in scene if instance.visible), default=0.0)
    return mean_emission(scene) >= (LEAST_EMISSION if brightest > UNLIT_RADIANCE else LEAST_OF_PAPER)


def _light_within(scene: Scene, visible: list[Instance], camera: Camera) -> tuple[str, str]:
    """A lamp, where the light of a studio doesn't get in. Returns the surroundings, and a remark on them."""
    dome = find_dome(visible)
    room = find_room(visible, extent(visible)) if dome is None else None
    if room is not None:
        add_lamp(scene, room)
        return "auto", "a room, and gets a lamp"
    place, closed = place_of(camera, visible)
    # The light of a studio comes from infinity: neither a dome nor a closed shell lets it in.
    if dome is None and not closed:
        return "studio", "shown in a studio"
    add_lamp(scene, place)
    return "auto", f"seen within a {'dome' if dome else 'closed shell'}, and gets a lamp"


def _add_sky(scene: Scene, camera: Camera, lit: bool) -> None:
    """A sky whose sun stands behind the camera's left shoulder, over a floor if the scene has no light of its own."""
    turn = heading(camera) + SUN_HEADING
    across = math.cos(SUN_HEIGHT)
    sky = Sky(np.array((across * math.sin(turn), math.sin(SUN_HEIGHT), across * math.cos(turn)), np.float32))
    if not lit:
        add_floor(scene, float(sky.ground_albedo.mean()))
    scene.environment = sky

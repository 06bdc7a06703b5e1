"""What surrounds a scene: its own environment or another one, and light for files that have none."""

from __future__ import annotations

import math

import numpy as np

from solari_vk.scene.lights.environment import Environment
from solari_vk.scene.lights.sky import Sky
from solari_vk.scene.model import Camera, Instance, Scene
from solari_vk.scene.presenting.enclosures import extent, find_dome, find_room, place_of
from solari_vk.scene.presenting.lamplight import Lamps, lamps_of, light_seen, solid_parts
from solari_vk.scene.presenting.studio_lights import add_floor, add_lamp, heading, studio_lights

# Radiance of white surfaces, in cd/m^2, that are lit: a thousandth of the studio's walls. Emissive surfaces that light
# less of what is seen are signs, screens and labels.
LEAST_LIGHT = 2e-4
SUN_HEADING = math.radians(-50)  # from the camera's heading
SUN_HEIGHT = math.radians(40)  # above the horizon


def surround(scene: Scene, camera: Camera, kind: str) -> tuple[str, bool]:
    """Surround a scene by "studio", "sky", "none" or a picture in a file; "auto" keeps what the scene has, and gives a
    scene without light a studio, or a lamp if it is a closed room, or if the camera is in a dome or a closed shell.

    camera: what turns with it. Returns what the scene got for want of light, "" if it has some, and whether a studio
    alone lights it, which suits EV100 0.
    """
    visible = [instance for instance in scene if instance.visible]
    lamps = lamps_of(visible)
    lit = any(light.emits for light in scene.lights) or (lamps is not None and _light_enough(camera, visible, lamps))
    remedy = ""
    if kind == "auto" and not lit:
        kind, remedy = _light_within(scene, visible, camera) if visible else ("studio", "shown in a studio")
        if lamps is not None:
            remedy += ", since its emissive surfaces light too little of what is seen"
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


def _light_enough(camera: Camera, visible: list[Instance], lamps: Lamps) -> bool:
    """Whether emissive surfaces light most of what the camera sees, or a closed place, where light gets everywhere."""
    seen = light_seen(camera, visible, lamps)
    if len(seen) and np.median(seen) >= LEAST_LIGHT:
        return True
    _, closed = place_of(camera, solid_parts(visible))
    x, y, z = np.ptp(extent(visible), axis=0).tolist()
    # Spread over the faces of the bounds: about what the light falls on.
    return closed and float(lamps.intensities.sum()) >= LEAST_LIGHT * 2 * (x * y + y * z + z * x)


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

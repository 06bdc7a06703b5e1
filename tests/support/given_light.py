"""Known light for the denoiser and antialiasing: GLSL expressions take the place of rendered light.

Nothing else of the frame runs but the G-buffer and the guides, so that the light of every pixel and frame is known.
"""

from contextlib import contextmanager

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte
from support.realtime import make_renderer
from support.seeded_bugs import Bug, seeded

SIZE = (96, 64)
DISTANCE = 2.0  # of the wall from the camera, in meters; the camera sees up and down by 45 degrees
PIXEL = 2.0 * DISTANCE / SIZE[1]  # the width of a pixel on the wall


def wall(*corners):
    """White quads seen by a camera at the origin that looks along -z; by default one wall that fills the picture."""
    scene = sv.Scene()
    far = 5 * DISTANCE
    default = [[-far, -far, -DISTANCE], [far, -far, -DISTANCE], [far, far, -DISTANCE], [-far, far, -DISTANCE]]
    scene.add(shapes.polygons(*(corners or (np.array(default),))), matte(1.0))
    scene.add(sv.Camera(vertical_fov=np.pi / 2))
    return scene


def moved(pixels):
    """The camera, moved to the right by this many pixels of the wall."""
    transform = np.eye(4)
    transform[0, 3] = PIXEL * pixels
    return sv.Camera(transform=transform, vertical_fov=np.pi / 2)


@contextmanager
def rendering(device, scene, file, function, body, passes, **settings):
    """A renderer in which a function of a shader, which gives a sample of light, has this body."""
    given = Bug(file, function, body)
    with seeded(given), make_renderer(device, scene, SIZE, passes=passes, **settings) as renderer:
        yield renderer

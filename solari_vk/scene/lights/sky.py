"""The clear sky as a light."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, field
from datetime import datetime
from typing import Any, ClassVar

import numpy as np

from solari_vk.base.color import LUMINANCE_WEIGHTS
from solari_vk.base.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.lights.atmosphere import EYE, atmosphere, sky_map
from solari_vk.scene.lights.directional import DirectionalLight
from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.sun_position import checked_place, checked_time, sun_direction
from solari_vk.scene.matrices import rotation
from solari_vk.scene.observable import checked

# In lux, of the sun above the atmosphere: Darula, Kittler and Gueymard, "Reference luminous solar constant and solar
# luminance for illuminance calculations" (2005).
SUN_ILLUMINANCE = 133_300.0
AFTERNOON = (-0.587, 0.643, 0.492)
_SUN_TWICE = "Sky: place and time say where the sun stands: leave these two out, or sun_direction"


@checked
class Sky(EnvironmentLight):
    """A clear sky with its sun, over even ground, as `scene.environment`.

    sun_direction (3,): towards the sun, of any length; below the horizon it is twilight. By default the sun stands 40
    degrees high, behind the left shoulder of a camera that looks along -z. place, time: the sun as it stands there
    then, where -z is north and +x east: Sky(place=(52.5, 13.4), time="2026-06-21 15:00+02:00"), of latitude and
    longitude in degrees, and a time with its zone, which may be a datetime; to assign another time moves the sun, and
    an assigned sun_direction takes their place. turbidity: 1 is clean air, 2
    to 3 a clear day, 6 haze. ground_albedo: the color of the ground, which fills the lower half. intensity: a factor;
    with 1 the sun has up to 100,000 lux and the sky thousands of cd/m^2, for pictures of an ev100 of about 14.
    The sun is a DirectionalLight of its own, `sun`, which `scene.environment` adds with the sky, and which follows the
    sky's fields. Its size is that of the real one. To turn the sun around the zenith is as cheap as moving a light;
    other changes compute the sky anew in about 0.1 s. solari_vk/scene/lights/atmosphere.py names the model.
    """

    sun_direction: FloatArray = field(default_factory=lambda: np.array(AFTERNOON, np.float32))
    _: KW_ONLY
    turbidity: float = 2.5
    ground_albedo: FloatArray = field(default_factory=lambda: np.full(3, 0.3, np.float32))
    intensity: float = 1.0
    place: tuple[float, float] | None = None
    time: datetime | None = None
    name: str = ""

    _converters = {
        "sun_direction": checks.direction,
        "turbidity": checks.number(1, 20),
        "ground_albedo": checks.color(0, 1),
        "intensity": checks.number(0, 1e9),
        "place": checked_place,
        "time": checked_time,
        "name": checks.text,
    }
    # What `_validate` makes for each sky from its fields.
    _made_of: ClassVar[tuple[object, ...]] = ()
    _sun: ClassVar[DirectionalLight]

    def _validate(self) -> None:
        """Make what follows from the fields: the image, the rotation and the sun."""
        if self.place is not None and self.time is not None:
            if not self._ready and not np.allclose(self.sun_direction, AFTERNOON, atol=1e-3):
                raise SolariError(_SUN_TWICE)
            object.__setattr__(self, "sun_direction", sun_direction(self.place, self.time).astype(np.float32))
        elif self.place is not None or self.time is not None:
            raise SolariError(
                "Sky: place and time go together: Sky(place=(52.5, 13.4), time='2026-06-21 15:00+02:00'), or both in "
                "sky.update(place=..., time=...)"
            )
        x, height, z = map(float, self.sun_direction)
        red, green, blue = map(float, self.ground_albedo)
        air = atmosphere(self.turbidity, (red, green, blue))
        # The map has the sun over its middle column. So its heading is a rotation, and only its height another map.
        if self._made_of != (air, height):
            image = (SUN_ILLUMINANCE * sky_map(air, height)).astype(np.float32)
            image.setflags(write=False)
            object.__setattr__(self, "image", image)
            object.__setattr__(self, "_made_of", (air, height))
        turn = rotation((0, 1, 0), -math.atan2(z, x)).astype(np.float32)
        object.__setattr__(self, "rotation", turn)
        # Sunlight is reddened and dimmed on its way, as in the map.
        arriving = air.transmittance(np.array([EYE]), np.array([height]))[0]
        brightness = float(arriving @ np.array(LUMINANCE_WEIGHTS))
        sun: dict[str, Any] = {
            "direction": -self.sun_direction,
            "illuminance": SUN_ILLUMINANCE * self.intensity * brightness,
            "color": arriving / brightness if brightness > 0 else 1.0,
        }
        if self._ready:
            self._sun.update(**sun)
        else:
            object.__setattr__(self, "_sun", DirectionalLight(**sun, name="sun"))

    def update(self, **fields: Any) -> None:
        if self._ready and "sun_direction" in fields:
            fields = {"place": None, "time": None} | fields
            if fields["place"] is not None or fields["time"] is not None:
                raise SolariError(_SUN_TWICE)
        super().update(**fields)

    def turn(self, angle: float) -> None:
        """Turn the sun about the y axis by an angle in radians."""
        self.sun_direction = (rotation((0, 1, 0), angle) @ self.sun_direction).astype(np.float32)

    @property
    def sun(self) -> DirectionalLight:
        """The sun."""
        return self._sun

    @property
    def lights(self) -> tuple[Light, ...]:
        """The sky and its sun."""
        return self, self.sun

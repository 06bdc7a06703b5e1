"""What all lights that aren't instances have in common, and the colors of black bodies."""

from __future__ import annotations

import numpy as np

from solari_vk.base.color import LUMINANCE_WEIGHTS
from solari_vk.base.errors import SolariError, checked_keywords, quoted
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.observable import Checked

COLDEST, HOTTEST = 1667.0, 25_000.0
# Kim et al., "Design of advanced color temperature control system for HDTV applications" (2002): cubic polynomials, the
# highest power first, of x in 1000 / T and of y in x, below and above 4000 K; of y also below 2222 K.
_X_WARM, _X_COLD = (-0.2661239, -0.2343589, 0.8776956, 0.179910), (-3.0258469, 2.1070379, 0.2226347, 0.240390)
_Y_RED = (-1.1063814, -1.34811020, 2.18555832, -0.20219683)
_Y_WARM, _Y_COLD = (-0.9549476, -1.37418593, 2.09137015, -0.16748867), (3.0817580, -5.87338670, 3.75112997, -0.37001483)
_RGB_OF_XYZ = np.array(
    [  # IEC 61966-2-1
        [3.2406, -1.5372, -0.4986],
        [-0.9689, 1.8758, 0.0415],
        [0.0557, -0.2040, 1.0570],
    ]
)


class Light(Checked):
    """A light that isn't an instance. Each subclass has a row in solari_vk/bound/lights/light_kinds.py."""

    @property
    def emits(self) -> bool:
        """Whether the light emits anything."""
        raise NotImplementedError

    @property
    def axes(self) -> tuple[str, ...]:
        """The fields that are directions, which turn with what carries the light."""
        return ()


@checked_keywords(who="solari_vk")
def kelvin(temperature: float) -> FloatArray:
    """The color (3,) of a black body at a temperature in kelvin, 1667 to 25,000, linear, of luminance 1.

    2700 is a warm bulb, 4000 neutral, 6500 daylight. As the `color` of a light it leaves the light's intensity as it
    is, and `emissive=20 * sv.kelvin(2700)` has 20 cd/m^2. Source: the fit of the Planckian locus by Kim et al. (2002).
    Raises SolariError for another temperature.
    """
    if not isinstance(temperature, (int, float, np.number)) or not COLDEST <= temperature <= HOTTEST:
        raise SolariError(f"kelvin: a temperature must be from {COLDEST:g} to {HOTTEST:g} K, not {quoted(temperature)}")
    x = np.polyval(_X_WARM if temperature <= 4000 else _X_COLD, 1000 / temperature)
    y_terms = _Y_WARM if temperature <= 4000 else _Y_COLD
    y = np.polyval(_Y_RED if temperature <= 2222 else y_terms, x)
    # Below about 1900 K the color lies outside of Rec. 709, and blue is cut off at 0.
    color = np.clip(_RGB_OF_XYZ @ (x / y, 1, (1 - x - y) / y), 0, None)
    found: FloatArray = (color / (color @ np.array(LUMINANCE_WEIGHTS))).astype(np.float32)
    return found

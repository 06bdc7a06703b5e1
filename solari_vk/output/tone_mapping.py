"""From radiance to colors on a screen: exposure, tone-mapping curves and sRGB. Pure numpy.

A curve takes exposed linear Rec. 709 colors (..., 3) and returns display-linear colors in [0, 1]; `encode_srgb` turns
these into the values that an 8-bit picture holds. The shaders have the same curves (glsl/passes/display/tonemap.glsl)
and take every number from here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.color import LUMINANCE_WEIGHTS, SRGB_GAMMA, SRGB_KNEE, SRGB_OFFSET, SRGB_SCALE, SRGB_SLOPE
from solari_vk.base.errors import SolariError, checked_keywords, is_name, quoted
from solari_vk.gpu.shaders import headers

Colors = NDArray[np.float32]
LUMINANCE = np.array(LUMINANCE_WEIGHTS, np.float32)
MIDDLE_GRAY = 0.18
NIGHT_EV100 = -10.0  # the least that is chosen: middle gray is the light of stars, and darker pictures stay dark
MAX_EXPOSED = 1e6  # brighter colors are clipped to this first, so that no curve overflows

# Medians of the lit pixels after exposure, where 1 is shown as white. Outside this range little can be seen.
VISIBLE_MEDIANS = 1e-4, 30.0
# A well exposed picture has at most this share of codes from CLIPPED_CODE on, and at least this one as a percentile.
CLIPPED_CODE = 250
MOST_CLIPPED = 0.05
BRIGHT_PERCENTILE = 95
LEAST_BRIGHT = 30

ACES_EXPOSURE = 0.6
# The fit is a ratio of two polynomials, of which these are the coefficients, highest power first.
ACES_NUMERATOR = (2.51, 0.03)
ACES_DENOMINATOR = (2.43, 0.59, 0.14)

AGX_INSET = np.array(
    [
        [0.842479062253094, 0.0784335999999992, 0.0792237451477643],
        [0.0423282422610123, 0.878468636469772, 0.0791661274605434],
        [0.0423756549057051, 0.0784336, 0.879142973793104],
    ]
)
AGX_CURVE = (15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232)  # highest power first
# The range of log2(color) that the curve is for: 10 stops below middle gray to 6.5 above.
AGX_MIN_STOPS = -12.47393
AGX_MAX_STOPS = 4.026069
AGX_GAMMA = 2.2
_AGX_OUTSET = np.linalg.inv(AGX_INSET).astype(np.float32)

# ---- curves -----------------------------------------------------------------------------------------


def clip(color: Colors) -> Colors:
    """No curve: everything above 1 is white."""
    return np.clip(color, 0, 1)


def reinhard(color: Colors) -> Colors:
    """L / (1 + L) on luminance, hue kept. Reinhard et al., "Photographic Tone Reproduction ...", SIGGRAPH 2002."""
    luminance: Colors = np.maximum(color @ LUMINANCE, 0)[..., None]
    mapped: Colors = np.clip(color / (1 + luminance), 0, 1)
    return mapped


def aces(color: Colors) -> Colors:
    """Fit of the ACES filmic curve. Narkowicz, "ACES Filmic Tone Mapping Curve", 2015 (with its 0.6 pre-exposure)."""
    x = np.clip(color, 0, MAX_EXPOSED) * np.float32(ACES_EXPOSURE)
    a, b = ACES_NUMERATOR
    c, d, e = ACES_DENOMINATOR
    return np.clip(x * (a * x + b) / (x * (c * x + d) + e), 0, 1)


def agx(color: Colors) -> Colors:
    """AgX base look (Sobotka), as the polynomial fit of Wrensch, "Minimal AgX Implementation", 2023."""
    inset = np.maximum(color, 0) @ AGX_INSET.T.astype(np.float32)
    stops = np.log2(np.maximum(inset, np.float32(1e-10)))
    x = np.clip((stops - AGX_MIN_STOPS) / (AGX_MAX_STOPS - AGX_MIN_STOPS), 0, 1)
    shaped = np.polyval(np.array(AGX_CURVE, np.float32), x)
    return np.clip(shaped @ _AGX_OUTSET.T, 0, 1) ** np.float32(AGX_GAMMA)


CURVES: dict[str, Callable[[Colors], Colors]] = {"none": clip, "reinhard": reinhard, "aces": aces, "agx": agx}
TONEMAPS = tuple(CURVES)
"""The names of the curves; the uniform `tonemap` is an index into them."""


def glsl_header() -> str:
    """`generated/output/tone_mapping.glsl`: TONEMAP_* and the numbers of the curves."""
    inset = ", ".join(map(repr, AGX_INSET.ravel().tolist()))
    scalars = {name: value for name, value in globals().items() if name.isupper() and isinstance(value, float)}
    return "\n".join(
        [
            headers.enumeration("TONEMAP", TONEMAPS),
            headers.constants(**scalars),
            f"const vec2 ACES_NUMERATOR = vec2{ACES_NUMERATOR};",
            f"const vec3 ACES_DENOMINATOR = vec3{ACES_DENOMINATOR};",
            f"const mat3 AGX_INSET = mat3({inset});  // by rows",
            f"const float AGX_CURVE[{len(AGX_CURVE)}] = float[]{AGX_CURVE};",
        ]
    )


# ---- from radiance to a picture ---------------------------------------------------------------------


@checked_keywords(who="solari_vk")
def tonemap(radiance: ArrayLike, *, exposure: float = 1.0, curve: str = "agx") -> Colors:
    """Linear colors (..., 3) in [0, 1] of radiance (..., 3) in cd/m^2 times exposure. They aren't sRGB codes yet.

    Saved or shown as they are, they look too dark: `encode_picture` gives the 8-bit sRGB codes of pictures, and
    `RenderedFrame.image` those of a frame. exposure: such as `camera.exposure`. curve: a name of `CURVES`. NaN becomes
    black, infinity white. Raises SolariError for an unknown curve.
    """
    if not is_name(curve, CURVES):
        raise SolariError(f"there is no tone mapping {quoted(curve)}; there are {', '.join(CURVES)}")
    with np.errstate(over="ignore"):  # becomes infinity, which is white
        exposed = np.asarray(radiance, np.float32) * np.float32(exposure)
    finite = np.nan_to_num(exposed, nan=0.0, posinf=MAX_EXPOSED, neginf=0.0)
    return CURVES[curve](finite).astype(np.float32)


def encode_srgb(linear: ArrayLike) -> Colors:
    """The sRGB transfer function (IEC 61966-2-1): linear [0, 1] to encoded [0, 1]."""
    x = np.clip(np.asarray(linear, np.float32), 0, 1)
    curved = SRGB_SCALE * x ** np.float32(1 / SRGB_GAMMA) - SRGB_OFFSET
    return np.where(x <= SRGB_KNEE, x * SRGB_SLOPE, curved).astype(np.float32)


@checked_keywords(who="solari_vk")
def encode_picture(radiance: ArrayLike, *, exposure: float = 1.0, curve: str = "agx") -> NDArray[np.uint8]:
    """The picture of radiance (..., 3) in cd/m^2 times exposure: tone-mapped sRGB codes (..., 3) from 0 to 255.

    exposure: such as `camera.exposure`. curve: as for `tonemap`, as are the errors.
    """
    encoded = encode_srgb(tonemap(radiance, exposure=exposure, curve=curve))
    return np.round(encoded * 255).astype(np.uint8)


@checked_keywords(who="solari_vk")
def auto_exposure(radiance: ArrayLike, surfaces: ArrayLike | None = None) -> float:
    """The EV100 that shows the log-average luminance of radiance (..., 3), in cd/m^2, as middle gray, 0.18.

    Pixels that are black, or a million times darker than the mean, are left out, so that a black background does not
    brighten the picture. surfaces (...): which pixels show a surface. If at least 1 % do, only they count, so that a
    bright sky doesn't make what stands before it black. At least -10, so that a night without a moon stays dark.
    Returns 0 for a picture without light.
    """
    luminance = np.asarray(radiance, np.float64) @ LUMINANCE.astype(np.float64)
    shown = None if surfaces is None else np.asarray(surfaces, bool)
    if shown is not None and shown.mean() >= 0.01:
        luminance = luminance[shown]
    luminance = luminance[np.isfinite(luminance) & (luminance > 0)]
    if not luminance.size:
        return 0.0
    # The logarithm weighs darkness as much as light: a few pixels near black would brighten the whole picture.
    luminance = luminance[luminance >= 1e-6 * luminance.mean()]
    average = np.exp(np.log(luminance).mean())
    # EV100 shows a luminance of 1.2 * 2^EV100 as white (saturation-based speed of ISO 12232).
    return float(np.clip(np.log2(average / (1.2 * MIDDLE_GRAY)), NIGHT_EV100, 100))


def unseen(picture: NDArray[Any]) -> str:
    """Why nothing can be seen in a picture after exposure: it is "black", "dark" or "bright"; "" if something can."""
    if not picture.any():
        return "black"
    typical = float(np.median(picture[picture > 0]))
    darkest, brightest = VISIBLE_MEDIANS
    if darkest < typical < brightest:
        return ""
    return "bright" if typical > 1 else "dark"


def misexposed(codes: NDArray[np.uint8]) -> str:
    """Whether sRGB codes (..., 3) of surfaces are clearly too "bright" or too "dark"; "" if neither."""
    lit = codes[codes.any(axis=-1)]
    if not lit.size:
        return "dark" if codes.size else ""
    if np.mean(codes >= CLIPPED_CODE) > MOST_CLIPPED:
        return "bright"
    return "dark" if np.percentile(lit, BRIGHT_PERCENTILE) < LEAST_BRIGHT else ""

"""The surfaces that a pulse of light meets, and how much of it comes back from each."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted, unknown_name
from solari_vk.data.annotate.surfaces import behind
from solari_vk.renderers.ray_tracer import RayTracer

Floats = NDArray[np.float64]
INVISIBLE = 256  # surfaces that neither reflect nor absorb light, which are passed beside those that count
FAINTEST = 1e-4  # the share of a pulse, there and back, below which it isn't followed
RED = 0  # the color that is nearest to the infrared, of which materials say nothing


class Echoes(NamedTuple):
    """Parts of pulses that come back, in the order of surfaces along each ray."""

    ray: NDArray[np.int64]
    """The number of the ray."""
    distance: Floats
    """In meters."""
    strength: Floats
    """Relative to a white Lambertian surface at the same distance that faces the sensor."""
    instance: NDArray[np.int32]
    """A key of the tracer's `instances`."""


def find_echoes(
    tracer: RayTracer, origins: Floats, directions: Floats, t_min: float, t_max: float, surfaces: int
) -> Echoes:
    """The echoes of pulses along rays (N, 3) of unit directions, from at most this many surfaces each.

    A surface sends back pi times its BRDF towards the sensor times the cosine, so that a white Lambertian surface that
    faces it has the strength 1. What a surface lets pass goes straight on, and its echoes pass that surface again.
    Surfaces that are fully transparent have no echo and don't count, up to INVISIBLE of them.
    """
    count = len(origins)
    start = np.full(count, t_min, np.float32)
    energy = np.ones(count)  # what a pulse still has after the surfaces that it passed, there and back
    left = np.full(count, surfaces)
    active = np.flatnonzero(np.isfinite(directions).all(axis=-1))
    parts = list[tuple[Any, ...]]()
    for _ in range(surfaces + INVISIBLE):
        if not len(active):
            break
        hits, echoes = tracer.backscatter(origins[active], directions[active], t_min=start[active], t_max=t_max)
        there = hits.instance >= 0
        active = active[there]
        hits = hits[there]
        echoes = echoes[there]
        # Backscatter is the BRDF towards the sensor times the cosine; pi makes a white Lambertian surface 1.
        strength = np.pi * energy[active] * echoes.backscatter[:, RED]
        sends = strength > 0
        # By the position, since drivers round `t` to what the whole triangle allows.
        along = ((hits.position - origins[active]) * directions[active]).sum(axis=-1)
        parts.append((active[sends], along[sends], strength[sends], hits.instance[sends]))
        # A surface that neither reflects nor absorbs doesn't count.
        left[active] -= sends | (echoes.passed[:, RED] < 1)
        # The echoes of farther surfaces pass this one a second time, so its transmission counts squared.
        energy[active] *= echoes.passed[:, RED].astype(np.float64) ** 2
        start[active] = behind(hits.t)
        active = active[(energy[active] > FAINTEST) & (left[active] > 0)]
    if not parts:
        return Echoes(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0, np.int32))
    return Echoes(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def check_tracer(who: str, tracer: Any) -> None:
    """Raise SolariError for what is no ray tracer."""
    if not isinstance(tracer, RayTracer):
        raise SolariError(f"{who}: a solari_vk.RayTracer is needed, not {quoted(tracer)}")


def checked_numbers(kind: Any, ranges: dict[str, tuple[float, float, str]]) -> None:
    """Raise SolariError for a field of a sensor that isn't a number within its range. ranges: lowest, highest, unit."""
    for name, (low, high, unit) in ranges.items():
        value = getattr(kind, name)
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not low <= value <= high:
            raise SolariError(
                f"{type(kind).__name__}: {name} is a number between {low:g} and {high:g}"
                f"{unit and f' {unit}'}, not {quoted(value)}"
            )


def from_preset(kind: type[Any], presets: dict[str, dict[str, Any]], name: str, fields: dict[str, Any]) -> Any:
    """An object with the fields of a preset, changed by others. Raises SolariError for an unknown preset."""
    if name not in presets:
        raise unknown_name(f"{kind.__name__} has no preset", name, presets)
    return kind(**{**presets[name], **fields})

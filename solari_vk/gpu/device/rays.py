"""The methods of tracing rays. A device is opened for one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

_STRUCTURES = ("VK_KHR_acceleration_structure", "VK_KHR_deferred_host_operations")  # the first depends on the second
RAYS = {
    "query": (*_STRUCTURES, "VK_KHR_ray_query"),
    "pipeline": (*_STRUCTURES, "VK_KHR_ray_tracing_pipeline"),
    "compute": (),
}
"""The extensions of each method, the preferred one first."""
OF_METHODS = frozenset(name for names in RAYS.values() for name in names)
AUTO = "auto"
IN_WORDS = {"query": "ray queries", "pipeline": "ray pipelines", "compute": "compute shaders"}
DRIVER = "Vulkan 1.3 and scalar block layouts"
"""What a driver must have, for messages."""
SOFTWARE = "software devices"
WITHOUT_UNITS = "cards without units for rays"
FASTER_BY_COMPUTE = frozenset({WITHOUT_UNITS})
"""On which of these kinds of devices compute shaders trace faster than what the driver has."""
WITH_UNITS = {1: "AMD", 2: "AMD, open source", 4: "NVIDIA", 5: "Intel on Windows", 6: "Intel, Mesa"}
"""The drivers (VkDriverId) that have ray queries on cards with units for rays alone. Others, such as Mesa's for AMD,
may have them on cards whose shaders do all of the work."""


@dataclass(frozen=True)
class RaySpeeds:
    """Millions of rays a second by ray queries and by compute shaders, measured on a day; or why that failed."""

    day: str
    query: float = 0.0
    compute: float = 0.0
    failure: str = ""

    def fastest(self) -> tuple[str, str]:
        """The method to take, and why."""
        if self.failure:
            remedy = "to measure again delete *.rays in the cache"
            return "query", f"measuring how fast it traces failed on {self.day}: {self.failure}; {remedy}"
        fast, slow = ("compute", "query") if self.compute > self.query else ("query", "compute")
        speed, other = getattr(self, fast), getattr(self, slow)
        figures = f"{speed:,.1f} million rays a second, {IN_WORDS[slow]} {other:,.1f}"
        return fast, f"{IN_WORDS[fast]} traced {figures}, measured on {self.day}"


def is_unlisted(missing: Mapping[str, Sequence[str]], kind: str, driver_id: int) -> bool:
    """Whether only a measurement says by what a device traces fastest: it has ray queries, but maybe no units."""
    has_both = missing.get("query") == missing.get("compute") == []
    return has_both and kind != "cpu" and driver_id not in WITH_UNITS


def automatic_method(
    missing: Mapping[str, Sequence[str]], kind: str, speeds: RaySpeeds | None = None
) -> tuple[str, str]:
    """The method that "auto" takes on a device of a kind such as "cpu", and why; "" if it has none.

    missing: what the device lacks for each method. speeds: what was measured, of a device that `is_unlisted`.
    """
    usable = [rays for rays in RAYS if rays in missing and not missing[rays]]
    if not usable:
        return "", "the device has no method of tracing rays"
    if speeds is not None:
        return speeds.fastest()
    group = _group(usable, kind)
    if usable[0] != "compute" and "compute" in usable and group in FASTER_BY_COMPUTE:
        return "compute", f"it is the fastest way on {group}"
    lacked = [IN_WORDS[rays] for rays in list(RAYS)[: list(RAYS).index(usable[0])]]
    if not lacked:
        return usable[0], f"the device has {IN_WORDS[usable[0]]}"
    return usable[0], f"the device has no {' and no '.join(lacked)}"


def _group(usable: Sequence[str], kind: str) -> str:
    """SOFTWARE, WITHOUT_UNITS, or "" for cards that trace in hardware."""
    if kind == "cpu":
        return SOFTWARE
    # NVIDIA's cards without units for rays have ray pipelines and no ray queries.
    return WITHOUT_UNITS if "query" not in usable else ""

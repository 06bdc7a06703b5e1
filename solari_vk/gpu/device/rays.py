"""The methods of tracing rays. A device is opened for one of them."""

from __future__ import annotations

RAYS = {"query": "VK_KHR_ray_query", "pipeline": "VK_KHR_ray_tracing_pipeline"}
"""The extension of each method, the preferred one first."""
AUTO = "auto"
IN_WORDS = {"query": "ray queries", "pipeline": "ray pipelines"}
EXTENSIONS = " or ".join(RAYS.values())
"""What a driver must have, for messages."""

"""What was measured on devices of which no list says whether ray queries or compute shaders trace faster.

Another process measures, by solari_vk/gpu/ray_speed.py, since a driver that fails may end its process or never return.
The disk cache keeps the result for a device, a version of its driver, and one of this package and its shaders.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from dataclasses import asdict
from typing import Any

from solari_vk.base import disk_cache
from solari_vk.gpu.device.rays import RaySpeeds

LONGEST = 120.0  # seconds
_SHADERS = ("passes/bare_rays/trace.comp", "scene/trees/build.comp")
_of_process: dict[str, RaySpeeds] = {}


def known_speeds(uuid: str, driver: str) -> RaySpeeds | None:
    """What was measured on the device with this UUID and driver version."""
    return _known(_entry(uuid, driver))


def measured_speeds(uuid: str, driver: str) -> RaySpeeds:
    """The same, measured now if it isn't known. Of several processes one measures, and the others wait for it."""
    entry = _entry(uuid, driver)
    speeds = _known(entry)
    if speeds is None:
        with disk_cache.alone(entry, LONGEST):
            speeds = _known(entry) or _measure(uuid)
            disk_cache.store(entry, json.dumps(asdict(speeds)).encode())
    _of_process[entry] = speeds
    return speeds


def _entry(uuid: str, driver: str) -> str:
    # Only here, since listed devices don't need them to be opened.
    from solari_vk.gpu.shaders.compiler import roots
    from solari_vk.gpu.shaders.shader_cache import Sources

    version = sys.modules["solari_vk"].__version__  # not imported, because the package itself imports this one
    sources = Sources(roots())
    parts = [uuid, driver, version, *(sources.key(path, "", "") for path in _SHADERS)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest() + ".rays"


def _known(entry: str) -> RaySpeeds | None:
    try:
        return _of_process.get(entry) or _speeds(json.loads(disk_cache.load(entry) or b""))
    except (ValueError, TypeError):
        return None


def _speeds(fields: dict[str, Any]) -> RaySpeeds:
    """Raises ValueError or TypeError for fields that are none."""
    speeds = RaySpeeds(**fields)
    if not (speeds.failure or min(speeds.query, speeds.compute) > 0):
        raise ValueError(f"these are no speeds: {fields}")
    return speeds


def _measure(uuid: str) -> RaySpeeds:
    day = time.strftime("%Y-%m-%d")
    # -P: no module of the current folder takes the place of another.
    command = [sys.executable, "-P", "-m", "solari_vk.gpu.ray_speed", uuid]
    how: Any = {"stdin": subprocess.DEVNULL, "capture_output": True, "text": True, "timeout": LONGEST}
    try:
        path = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
        done = subprocess.run(command, check=False, env={**os.environ, "PYTHONPATH": path}, **how)
        if not done.returncode:
            return _speeds({"day": day, **json.loads(done.stdout)})
        reason = (done.stderr.strip().splitlines() or [f"its process ended with code {done.returncode}"])[-1]
    except (OSError, subprocess.SubprocessError, ValueError, TypeError) as error:
        reason = str(error)
    return RaySpeeds(day, failure=reason)

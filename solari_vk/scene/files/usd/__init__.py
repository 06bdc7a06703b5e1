"""USD files, by the library usd-core, which is imported when the first of them is read."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import util
from typing import Any

from solari_vk.base.budget import load_budget
from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.scene.files.formats import reads

INSTALL = "pip install 'solari-vk[usd]'"


@checked_keywords(who="solari_vk")
@reads(
    ".usd",
    ".usda",
    ".usdc",
    ".usdz",
    options=("variants",),
    only="USD files have sets of variants: leave out the option `variants`",
)
def load_usd(
    path: str | os.PathLike[str], *, variants: Mapping[str, str | Mapping[str, str]] | None = None, strict: bool = False
) -> Any:
    """Load a .usd, .usda, .usdc or .usdz file with all that it refers to in its own folder.

    variants: what is chosen in sets of variants: {"color": "red"} in all sets of this name, {"/World/Car": {"color":
    "red"}} in that of one prim. Lengths become meters and the up axis y. What is there at the file's first time code is
    the rest pose; `Scene.animations` has the rest. `Scene.warnings` names what can't be shown; with `strict`, parts
    with wrong data are errors. Raises SolariError without usd-core, for a file that is missing, damaged or hostile, for
    layers that are missing, refer to each other in a circle or are outside the folder, for variants that the file
    hasn't, and for what needs more than `load` allows.
    """
    if util.find_spec("pxr") is None:
        raise SolariError(f"{path}: USD files need a library that isn't installed: install it by {INSTALL}")
    # Here, because it imports usd-core.
    from solari_vk.scene.files.usd.loader import load_stage

    with load_budget():
        return load_stage(path, variants or {}, strict)

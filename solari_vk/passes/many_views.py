"""Frames of many views at once: their pictures in a grid; glsl/passes/views.glsl."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.frame.stages import Draw, Pass, Size, Stage, Step
from solari_vk.gpu.shaders.compiler import MANY_VIEWS, has_many_views


def grid(size: Size, views: int, max_side: int) -> Size:
    """The columns and rows of a grid for pictures of this size that is nearly square, within the device's largest
    side of an image."""
    columns = round(math.sqrt(views * size[1] / size[0]))  # of a grid that is as wide as high
    columns = max(1, min(columns, views, max_side // size[0]))
    # At least as many as leave no more rows than the device's images have room for.
    columns = max(columns, -(-views // max(max_side // size[1], 1)))
    return columns, -(-views // columns)


def tiled(size: Size, of: Size) -> Size:
    """The size of a grid, of so many columns and rows, of pictures of this size."""
    return size[0] * of[0], size[1] * of[1]


def upload_rows(table: Buffer, rows: NDArray[np.uint8], worlds: int) -> None:
    """Upload the bytes of a table of several worlds, one after the other, to one that has grown."""
    # Each world's rows stand together, so they move apart when all worlds get more rows.
    grown = np.zeros((worlds, table.size // worlds), np.uint8)
    grown[:, : rows.size // worlds] = rows.reshape(worlds, -1)
    table.upload(grown)


def over_views(stages: Sequence[Stage]) -> list[Stage]:
    """The stages of one view's frame, as those of a frame of all `views`, without debug views. Their sizes are those of
    the grid.

    Inputs: `views`, and where rays are traced `world_structures`. Raises SolariError for stages that draw.
    """

    def of_views(item: Pass | Draw | Step) -> Pass | Draw | Step:
        if isinstance(item, Draw):
            raise SolariError(f"{item.name}: raster draws one view at a time: leave the setting gbuffer at auto")
        if not isinstance(item, Pass) or not has_many_views(f"passes/{item.name}.comp"):
            return item  # it doesn't go by pixels of a view
        return dataclasses.replace(item, header=f"{MANY_VIEWS}\n{item.header}".rstrip())

    replaced = []
    for stage in stages:
        passes = [of_views(one) for one in stage.passes if "debug_view" not in one.name]
        replaced.append(dataclasses.replace(stage, passes=passes))
    return replaced

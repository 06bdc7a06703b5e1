"""What was edited in recent frames, for passes that follow it: the lights that were added, removed, moved or changed in
power, and how much light edits of the scene may have changed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights.index_translation import (
    CHANGE_DECAY,
    MIN_CHANGE,
    Ids,
    Positions,
    Powers,
    translate,
    with_decayed,
)

MAX_CHANGED_LIGHTS = 8  # lights in the list: those that changed most
# ChangedLight in glsl/passes/light_change.glsl.
RECORD = np.dtype([("place", "<f4", 3), ("power", "<f4"), ("recent", "<f4")])
# From this change of power on since a light was listed last, over the larger power, the light is listed again.
MIN_LISTED_CHANGE = 0.15
# A light whose `recent` is above this is changing all the time: another change of it is no new one.
STILL_CHANGING = CHANGE_DECAY**10

# The share of the light that an edit of a scene is taken to change: the first one after PAUSE frames without one of its
# kind, and others of looks. More makes pictures flicker that are edited in each frame, as by animations.
FIRST_EDIT = 0.25
PAUSE = 8
EDITED_LOOKS = 0.02

Records = NDArray[Any]
Lists = tuple[Ids, Powers, Positions, Positions]
"""Ids, powers, places and positions; a position, unlike a place, also moves when a light turns."""


def compare(old: Lists, new: Lists, cell_size: float) -> tuple[NDArray[np.uint64], Records, Powers]:
    """The keys and records of the lights that differ between two lists, and the powers with which the lights of the new
    list were listed last.

    The powers of the old list are those with which lights were listed last, so that slow changes add up. Less than
    MIN_LISTED_CHANGE of a power doesn't count, or flicker would shorten all histories. A light that moves by
    `cell_size` meters from one frame to the next counts where it was and where it is; slower ones move shadows, which
    the denoiser sees.
    A key is twice the light's id, and one more for the place that a light has left. Lights without power,
    such as portals, change nothing.
    """
    old_ids, old_powers, old_places, old_positions = old
    ids, powers, places, positions = new
    rows = translate(old_ids, ids)
    is_left = rows != NO_INDEX
    left = rows[is_left]  # the new rows of the lights that are in both lists
    added = np.ones(len(ids), bool)
    added[left] = False

    changes = np.abs(powers[left] - old_powers[is_left])
    differs = changes > MIN_LISTED_CHANGE * np.maximum(powers[left], old_powers[is_left])
    # A light that jumps takes all of its power from one place to the other.
    jumps = np.linalg.norm(positions[left] - old_positions[is_left], axis=1) > cell_size
    changes = np.where(jumps, powers[left], changes)
    differs |= jumps
    gone = ~is_left
    gone[np.flatnonzero(is_left)[jumps]] = True

    # Slow changes add up: what isn't listed now is compared with the same power again in the next frame.
    listed_powers = np.array(powers)
    listed_powers[left[~differs]] = old_powers[is_left][~differs]
    records = np.zeros(np.count_nonzero(differs) + np.count_nonzero(added) + np.count_nonzero(gone), RECORD)
    records["place"] = np.concatenate([places[left[differs]], places[added], old_places[gone]])
    records["power"] = np.concatenate([changes[differs], powers[added], old_powers[gone]])
    records["recent"] = 1.0
    here = 2 * np.concatenate([ids[left[differs]], ids[added]]).astype(np.uint64)
    keys = np.concatenate([here, 2 * old_ids[gone].astype(np.uint64) + 1])
    emits = records["power"] > 0
    return keys[emits], records[emits], listed_powers


class RecentChanges:
    """The lights that changed most in recent frames. Lights at infinity have no place and are left out."""

    def __init__(self) -> None:
        self._seen: tuple[Any, ...] | None = None  # the arrays of the previous frame
        self._old: Lists | None = None
        self.clear()

    def clear(self) -> None:
        """Forget all changes so far."""
        self._keys: NDArray[np.uint64] = np.zeros(0, np.uint64)
        self._records: Records = np.zeros(0, RECORD)

    @property
    def records(self) -> Records:
        """The changes (N,), of which there are at most MAX_CHANGED_LIGHTS."""
        return self._records

    def copy(self) -> RecentChanges:
        """Another list with the same changes."""
        made = RecentChanges()
        made._seen = self._seen
        made._old = self._old
        made._keys = self._keys
        made._records = self._records.copy()
        return made

    @property
    def uniforms(self) -> dict[str, Any]:
        """The values of the uniform block `changed_lights`."""
        padded = np.zeros(MAX_CHANGED_LIGHTS, RECORD)
        padded[: len(self._records)] = self._records
        return {"changed_lights.count": len(self._records), "changed_lights.at": padded}

    def update(self, ids: Ids, powers: Powers, places: Positions, positions: Positions, cell_size: float) -> None:
        """Update the list for a frame with these lights, of which the first ones have places.

        Arrays that are the same objects as in the previous call are taken to be unchanged. places: (N, 3), and
        positions: (N or more, 3), in meters.
        """
        if len(self._records):
            self._records["recent"] *= CHANGE_DECAY
            lasting = self._records["recent"] > MIN_CHANGE
            self._keys = self._keys[lasting]
            self._records = self._records[lasting]
        now = ids, powers, places, positions
        if self._seen is not None and all(a is b for a, b in zip(self._seen, now, strict=True)):
            return
        count = len(places)
        new = ids[:count], powers[:count], places, positions[:count]
        if self._old is not None:
            keys, records, listed_powers = compare(self._old, new, cell_size)
            self._add(keys, records)
            new = ids[:count], listed_powers, places, positions[:count]
        self._seen = now
        self._old = new

    def _add(self, keys: NDArray[np.uint64], records: Records) -> None:
        """Add records; of a light, that of the largest change counts."""
        changing = self._keys[self._records["recent"] > STILL_CHANGING]
        records["recent"][np.isin(keys, changing)] = CHANGE_DECAY
        self._keep_largest(keys, records)

    def merge(self, other: RecentChanges) -> None:
        """Add the changes of another list of the same lights."""
        self._keep_largest(other._keys, other._records)

    def _keep_largest(self, keys: NDArray[np.uint64], records: Records) -> None:
        keys = np.concatenate([keys, self._keys])
        records = np.concatenate([records, self._records])
        # Of each key the first record in the order of their size is the largest one.
        order = np.argsort(-records["power"] * records["recent"], kind="stable")
        first = np.sort(np.unique(keys[order], return_index=True)[1])[:MAX_CHANGED_LIGHTS]
        self._keys = keys[order][first]
        self._records = records[order][first]


class RecentEdits:
    """What edits of a scene, or of each of several, have changed since the history began that follows them: numbers (),
    or arrays (W,)."""

    def __init__(self) -> None:
        self.newest: Any = 0.0
        """The share of the light that edits since the previous frame may have changed."""
        self.share: Any = 0.0
        """The same of recent frames; it decays."""
        self.blended: NDArray[np.bool_] = np.zeros(1, bool)
        """Whether blended instances have changed since the previous frame."""
        self._counts: NDArray[np.int64] | None = None
        self._unedited: Any = PAUSE  # frames without an edit of the kind

    def forget(self, where: Any = True) -> None:
        """Forget all edits so far. where: (W,), of several scenes those that forget."""
        self.share = np.where(where, 0.0, self.share)
        self._unedited = np.where(where, PAUSE, self._unedited)

    def update(self, counts: NDArray[np.int64], of_lights: float = 0.0) -> None:
        """Compare with the previous frame. counts: `SceneRecords.edit_counts`, (3,) or (3, W). of_lights: the share of
        the light by which lights have changed."""
        edited = counts != (counts if self._counts is None else self._counts)
        looks, _, self.blended = edited
        first = edited & (self._unedited >= PAUSE)
        self.newest = np.maximum(of_lights, np.maximum(FIRST_EDIT * (first[0] | first[1]), EDITED_LOOKS * looks))
        self.share = with_decayed(self.share, self.newest)
        self._unedited = np.where(edited, 0, self._unedited + 1)
        self._counts = counts

"""The lights that were added, removed, moved or changed in power in recent frames, for passes that follow them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.constants import NO_INDEX
from solari_vk.scene.light_translation import CHANGE_DECAY, MIN_CHANGE, Ids, Positions, Powers, translate

MOST = 8  # lights in the list: those that changed most
RECORD = np.dtype([("place", "<f4", 3), ("power", "<f4"), ("recent", "<f4")])
"""ChangedLight in glsl/passes/light_change.glsl."""

Records = NDArray[Any]


def compare(
    old: tuple[Ids, Powers, Positions], new: tuple[Ids, Powers, Positions], cell_size: float
) -> tuple[Ids, Records]:
    """The ids and records of the lights that differ between two lists of ids, powers and places.

    A light that moves counts by its distance over `cell_size`, in meters, up to its whole power. Changes below
    MIN_CHANGE of the light's power don't count.
    """
    (old_ids, old_powers, old_places), (ids, powers, places) = old, new
    rows = translate(old_ids, ids)
    stayed = rows != NO_INDEX
    kept = rows[stayed]
    added = np.ones(len(ids), bool)
    added[kept] = False
    distances = np.linalg.norm(places[kept] - old_places[stayed], axis=1)
    changes = np.abs(powers[kept] - old_powers[stayed]) + powers[kept] * np.minimum(distances / cell_size, 1.0)
    differs = changes > MIN_CHANGE * powers[kept]
    kept, changes = kept[differs], changes[differs]
    records = np.zeros(len(kept) + np.count_nonzero(added) + np.count_nonzero(~stayed), RECORD)
    records["place"] = np.concatenate([places[kept], places[added], old_places[~stayed]])
    records["power"] = np.concatenate([changes, powers[added], old_powers[~stayed]])
    records["recent"] = 1.0
    return np.concatenate([ids[kept], ids[added], old_ids[~stayed]]), records


class ChangedLights:
    """The lights that changed most in recent frames. Lights at infinity have no place and are left out."""

    def __init__(self) -> None:
        self._seen: tuple[Ids, Powers, Positions] | None = None
        self.clear()

    def clear(self) -> None:
        """Forget all changes so far."""
        self._ids: Ids = np.zeros(0, np.uint32)
        self._records: Records = np.zeros(0, RECORD)

    @property
    def uniforms(self) -> dict[str, Any]:
        """The values of the uniform block `changed_lights`."""
        padded = np.zeros(MOST, RECORD)
        padded[: len(self._records)] = self._records
        return {"changed_lights.count": len(self._records), "changed_lights.at": padded}

    def update(self, ids: Ids, powers: Powers, places: Positions, cell_size: float) -> None:
        """Update the list for a frame with these lights, of which the first ones have places.

        An array that is the same object as in the previous call is taken to be unchanged. places: (N, 3) in meters.
        """
        self._records["recent"] *= CHANGE_DECAY
        lasting = self._records["recent"] > MIN_CHANGE
        self._ids, self._records = self._ids[lasting], self._records[lasting]
        new = ids, powers, places
        if self._seen is not None and any(a is not b for a, b in zip(self._seen, new, strict=True)):
            old_ids, old_powers, old_places = self._seen
            count, old_count = len(places), len(old_places)
            old_list = old_ids[:old_count], old_powers[:old_count], old_places
            found, records = compare(old_list, (ids[:count], powers[:count], places), cell_size)
            self._add(found, records)
        self._seen = new

    def _add(self, ids: Ids, records: Records) -> None:
        """Add records; of a light, that of the largest change counts. Lights that are listed already go on changing."""
        records["recent"][np.isin(ids, self._ids)] = CHANGE_DECAY
        ids, records = np.concatenate([ids, self._ids]), np.concatenate([records, self._records])
        order = np.argsort(-records["power"] * records["recent"], kind="stable")
        first = np.sort(np.unique(ids[order], return_index=True)[1])[:MOST]
        self._ids, self._records = ids[order][first], records[order][first]

"""The uniform block on the host: a record whose fields are set by name."""

from __future__ import annotations

from typing import Any

import numpy as np

from solari_vk.errors import SolariError


class Uniforms:
    """The uniform block as a record: fields by name, of the shapes that the shaders give them.

    Matrices are stored by columns: assign a numpy matrix transposed. Values stay until they are changed, and each
    frame takes those of the moment it is submitted.
    """

    def __init__(self, dtype: np.dtype[Any] | None, name: str) -> None:
        self._name = name
        self.record = np.zeros(1, dtype if dtype is not None else np.dtype([]))
        self._fields = {field: self.record[field] for field in self.record.dtype.names or ()}

    def __getitem__(self, field: str) -> Any:
        self._check(field)
        return self._fields[field][0]

    def __setitem__(self, field: str, value: Any) -> None:
        self._check(field)
        target = self._fields[field]
        shape = value.shape if isinstance(value, np.ndarray) else np.shape(value)
        if shape != target.shape[1:] and shape:
            raise SolariError(f"{self._name}.{field} has shape {target.shape[1:]}, not {shape}")
        try:
            target[0] = value
        except (TypeError, ValueError, OverflowError) as error:
            raise SolariError(f"{self._name}.{field} is {target.dtype}: {error}") from error

    def __contains__(self, field: str) -> bool:
        return field in self._fields

    def _check(self, field: str) -> None:
        if field not in self:
            known = ", ".join(self.record.dtype.names or ()) or "none"
            raise SolariError(f"the shaders' {self._name} have no field {field}; there are {known}")

    def keep_from(self, older: Uniforms) -> None:
        """Take over the values of fields that have the same name and type."""
        for field in self.record.dtype.names or ():
            if field in older and older.record.dtype[field] == self.record.dtype[field]:
                self.record[field] = older.record[field]

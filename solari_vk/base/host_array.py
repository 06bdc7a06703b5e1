"""Arrays and tensors of any library as numpy arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def host_array(value: Any) -> NDArray[Any]:
    """`np.asarray`, also of tensors that need a gradient (PyTorch) or are in the memory of another device, whose values
    are copied once the work that makes them is done. Raises TypeError for a tensor without numbers."""
    # By their methods, so that neither library is imported for who has it installed and doesn't use it.
    if hasattr(value, "detach") and hasattr(value, "cpu"):  # PyTorch
        try:
            value = value.detach().cpu()
        except NotImplementedError as error:
            raise TypeError(f"must have numbers, unlike a tensor of the device 'meta': {error}") from None
    elif hasattr(value, "__cuda_array_interface__") and hasattr(value, "get"):  # CuPy
        value = value.get()
    return np.asarray(value)

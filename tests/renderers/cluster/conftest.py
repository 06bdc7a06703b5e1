"""Tests of workers in processes of their own, with a real scheduler. They need dask.distributed."""

import pytest

pytest.importorskip("distributed")

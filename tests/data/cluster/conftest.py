"""Tests of data sets that workers render. They need dask.distributed."""

import pytest

pytest.importorskip("distributed")

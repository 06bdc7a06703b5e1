"""`solari-vk bench claims`: each pair runs at a tiny size, and verdicts follow from the measured numbers."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.cli import main
from solari_vk.measure.claims.pairs import PAIRS
from solari_vk.measure.claims.run import HEAD, compare, holds, table_rows


@pytest.mark.parametrize("pair", [
    pytest.param(pair, marks=[] if pair.name == "spatial_radius" else pytest.mark.slow, id=pair.name) for pair in PAIRS
])  # fmt: skip
def test_pair_runs(device, pair):
    """The numbers are finite, and nothing else is asked at this size."""
    found = compare(device, pair, (16, 16), 2)
    assert found.shape == (2, 2, len(pair.what))
    assert np.isfinite(found).all()
    rows = table_rows(pair, *found)
    assert rows[0][0] == pair.name
    assert {len(row) for row in rows} == {len(HEAD)}


@pytest.mark.parametrize(("before", "after", "by", "expected"), [
    ([10, 11, 10], [4, 4, 4.2], 2.0, True), ([10, 11, 10], [6, 6, 6.2], 2.0, False),
    ([300, 310, 305], [0, 0, 0], 20.0, True), ([1, 1, 1], [1, 1, 1], 1.0, True),  # what doesn't scatter and isn't worse
    ([10, 30, 20], [9, 10, 11], 1.5, False),  # the spread is too wide to tell
    ([30], [1], 1.5, False),  # one run has no interval
])  # fmt: skip
def test_verdicts(before, after, by, expected):
    assert holds(np.array(before, float), np.array(after, float), by) == expected


def test_wrong_usage(any_device, tmp_path, capsys):
    assert main(["bench", "claims", "--only", "nothing"]) == 2
    assert "there is no claim 'nothing'" in capsys.readouterr().err
    assert main(["bench", "claims", "--markdown", str(tmp_path / "none" / "page.md")]) == 2
    assert main(["bench", "frame", str(tmp_path / "none.gltf")]) == 2
    assert main(["bench", "frame", str(tmp_path / "none.py:folder")]) == 2

"""`solari-vk bench cpu`: its table, by made-up times and by fake renderers."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from solari_vk.base.errors import SolariError
from solari_vk.lab.measure import cpu
from solari_vk.lab.trial import process
from solari_vk.lab.trial.compare import Comparison, Reached, Result
from solari_vk.lab.trial.process import KINDS, OURS, Kind, Render

FAKE = """
import numpy as np
def load(job, folder):
    def render(samples, seed, denoise=False):
        noise = np.random.default_rng(1000 * samples + seed).standard_normal((16, 24, 3))
        return 1 + {noise} * noise / ({times} if denoise else samples) ** 0.5
    return render
"""


def result(**reached):
    picture = Render(np.ones((1, 1, 3)), 0.0, 0.0)
    return Result([picture, picture], 0.0, {getattr(cpu, goal): Reached(*values) for goal, values in reached.items()})


def test_rows():
    """Raw times are brought to the goal; pictures in motion have as many seconds as a frame."""
    found = Comparison(
        {
            OURS: result(COARSE=(64, 0.008, 0.0, 5.0), FINE=(512, 0.001, 0.0, 40.0), DENOISED=(4, 0.004, 0.0, 0.5)),
            "cycles": result(COARSE=(32, 0.01, 0.0, 2.0)),
            "mitsuba": result(),
        }
    )
    ours, cycles, mitsuba, realtime = cpu.rows(found, (0.02, 0.1))
    assert ours[1:] == ["4.00", "40.00", "0.50", "1.00", "0.4"]
    assert cycles[1:] == ["2.00", "", "", "0.50", "0.2"]
    assert mitsuba[1:] == [""] * 5
    assert realtime[-1] == "0.02 (0.10 s a frame)"
    assert "crashed" in cpu.rows(found, "crashed")[-1][0]


@pytest.fixture
def fakes(tmp_path, monkeypatch):
    """The child process whose renderers are fakes: the relMSE of N samples is 0.036 / N."""
    for kinds in (process.KINDS, cpu.REALTIME):
        for name, kind in kinds.items():
            package = OURS if kind.package == OURS else "numpy"
            monkeypatch.setitem(kinds, name, Kind(kind.title, kind.module, package, kind.denoises))
            (tmp_path / f"{kind.module}.py").write_text(FAKE.format(noise=0.19, times="16 * samples"))
    return shutil.copy(process.CHILD, tmp_path)


def test_the_page(fakes, tmp_path, capsys):
    page = tmp_path / "cpu.md"
    cpu.run(None, ["cycles", "mitsuba"], [], (24, 16), 256, ["closed_box"], 30.0, page, child=fakes)
    shown = capsys.readouterr().out
    for what in ("0.01, 4 samples", "0.001, 64 samples", "0.005 denoised, 1 samples"):
        assert f"relMSE of {what}" in shown
    assert "relMSE of 0.01, 8 samples" not in shown
    assert "relMSE of 0.001, 2 samples" not in shown, "a smaller error takes no fewer samples"
    assert "mitsuba: time to a relMSE of 0.005" not in shown
    for title in (*(KINDS[name].title for name in (OURS, "cycles", "mitsuba")), cpu.REALTIME["realtime"].title):
        assert f"| {title} |" in page.read_text()


def test_wrong_names_are_refused():
    with pytest.raises(SolariError, match="there is no renderer 'cycels'"):
        cpu.run(None, ["cycels"], [], (24, 16), 8, [], 30.0, None)
    with pytest.raises(SolariError, match="no built-in scene"):
        cpu.run(None, [], [], (24, 16), 8, ["cornel_box"], 30.0, None)

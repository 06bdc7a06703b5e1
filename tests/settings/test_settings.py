"""Settings as a user meets them: ranges, text, presets, and that the shaders have every one."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.gpu.shaders.compiler import compile_shader, glsl_root
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.passes import reference
from solari_vk.settings import DEFAULTS, FIELDS, QUALITIES, allowed, uniform_values
from solari_vk.settings.shaders import UNIFORMS

CHOICES = [name for name, field in FIELDS.items() if field.choices]
SWITCHES = [name for name, default in DEFAULTS.items() if isinstance(default, bool)]
NUMBERS = [name for name in FIELDS if name not in CHOICES and name not in SWITCHES]


def test_defaults_are_allowed_and_have_a_meaning():
    settings = sv.Settings()
    for name, field in FIELDS.items():
        setattr(settings, name, getattr(settings, name))
        assert field.meaning.endswith((".", "!")), name
        assert allowed(name)
        if name in NUMBERS:
            assert any(word in field.meaning for word in ("More: ", "Less: ")), f"{name}: what does more of it do?"
        if field.choices:
            assert DEFAULTS[name] == field.choices[0], f"{name}: the first choice is the default"


def test_ranges():
    for name in NUMBERS:
        settings, field = sv.Settings(), FIELDS[name]
        for value in (field.low, field.high):
            setattr(settings, name, value)
            assert getattr(settings, name) == value
            assert type(getattr(settings, name)) is type(DEFAULTS[name])
        for value in (field.low - 1, field.high * 2, math.nan, math.inf, "much", None, [1]):
            with pytest.raises(sv.SolariError, match=name):
                setattr(settings, name, value)
        assert getattr(settings, name) == field.high, "what is refused changes nothing"
        if isinstance(DEFAULTS[name], int):
            with pytest.raises(sv.SolariError, match="whole"):
                setattr(settings, name, field.low + 0.5)
    with pytest.raises(sv.SolariError, match="power of two"):
        sv.Settings(world_cache_cells=1025)


def test_choices_and_switches():
    settings = sv.Settings()
    for name in CHOICES:
        for choice in FIELDS[name].choices:
            settings.update(f"{name}={choice}")
            assert getattr(settings, name) == choice
        with pytest.raises(sv.SolariError, match=FIELDS[name].choices[0]):
            setattr(settings, name, "smell")
    for name in SWITCHES:
        for text, value in (("off", False), ("ON", True), (" no ", False), ("1", True), ("false", False)):
            settings.update(f"{name}={text}")
            assert getattr(settings, name) is value
        for value in ("on", 2, None):
            with pytest.raises(sv.SolariError, match=name):
                setattr(settings, name, value)
        with pytest.raises(sv.SolariError, match="on or off"):
            settings.update(f"{name}=maybe")


def test_text():
    settings = sv.Settings()
    settings.update("di-candidates = 12")
    settings.update("gi_confidence_cap=2.5e1")
    assert (settings.di_candidates, settings.gi_confidence_cap) == (12, 25.0)
    for text, words in (
        ("di_candidates", "name=value"),
        ("fog=1", "fog.*nearest.*`solari-vk settings`"),
        ("di_candidates=few", "whole number"),
        ("di_candidates=", "di_candidates"),
        ("=3", "no setting ''"),
    ):
        with pytest.raises(sv.SolariError, match=words):
            settings.update(text)


def test_unknown_names():
    for settle in (lambda name: sv.Settings(**{name: 1}), lambda name: sv.Settings().update(f"{name}=1")):
        with pytest.raises(sv.SolariError, match="no setting 'di_spatia'; did you mean 'di_spatial'"):
            settle("di_spatia")
        with pytest.raises(sv.SolariError, match=r"no setting 'quality'; Settings.preset\('solari'\) gives"):
            settle("quality")
    with pytest.raises(sv.SolariError, match=r"fog.*nearest.*`solari-vk settings`"):
        sv.Settings().fog = 1  # type: ignore[attr-defined]
    with pytest.raises(sv.SolariError, match="fog"):
        sv.Settings().reset("fog")


def test_presets():
    for quality, changed in QUALITIES.items():
        settings = sv.Settings.preset(quality)
        assert {name: getattr(settings, name) for name in DEFAULTS} == {**DEFAULTS, **changed}
        settings.reset()
        assert settings == sv.Settings()
    with pytest.raises(sv.SolariError, match="low, medium, high, ultra, solari, not 'best'"):
        sv.Settings.preset("best")


def test_the_revision_grows_with_every_change():
    settings = sv.Settings()
    revisions = [settings.revision]
    settings.di_candidates = 5
    revisions.append(settings.revision)
    with pytest.raises(sv.SolariError):
        settings.di_candidates = 0
    assert settings.revision == revisions[-1]
    settings.reset("di_candidates")
    revisions.append(settings.revision)
    assert sorted(set(revisions)) == revisions
    assert settings.di_candidates == DEFAULTS["di_candidates"]


def test_shaders_use_every_live_setting():
    """What rebuilds the frame is no uniform, and jitter moves the camera."""
    texts = "".join(path.read_text() for path in glsl_root().rglob("*") if path.suffix in (".glsl", ".comp"))
    assert all(re.search(rf"\b{re.escape(name)}\b", texts) for name in UNIFORMS.values())
    assert set(FIELDS) - set(UNIFORMS) == {name for name, field in FIELDS.items() if field.rebuilds} | {"jitter"}
    for name in UNIFORMS:
        for index, choice in enumerate(FIELDS[name].choices):
            assert uniform_values(sv.Settings(**{name: choice}))[UNIFORMS[name]] == index
    assert uniform_values(sv.Settings(di_candidates=5))["restir_di_settings.candidates"] == 5


def test_the_blocks_have_the_settings_types():
    """The declarations that the shaders include, as a compiler reads them."""
    path = "passes/solari019/restir_di/initial_and_temporal.comp"
    blocks = reflect(compile_shader(path), path).bindings
    values = uniform_values(sv.Settings())
    for name in ("restir_di_settings", "reuse_settings"):
        dtype = blocks[name].dtype
        assert [f"{name}.{field}" for field in dtype.names] == [key for key in values if key.startswith(name + ".")]
        for field in dtype.names:
            assert dtype[field].kind == ("f" if isinstance(values[f"{name}.{field}"], float) else "u")


def test_words_for_settings_leave_out_defaults():
    assert repr(sv.Settings()) == "Settings()"
    assert repr(sv.Settings(denoise=False, upscale=2)) == "Settings(upscale=2.0, denoise=False)"


@pytest.mark.parametrize("wrong", [["agx"], {}, 3, np.zeros(2)], ids=repr)
def test_choices_are_names(wrong):
    """What can't be looked up in a dictionary, or compared, is named as any other wrong value."""
    for choose in (
        lambda: sv.Settings(lighting=wrong),
        lambda: sv.Settings(denoise=wrong),
        lambda: sv.Settings.preset(wrong),
        lambda: sv.builtin(wrong),
        lambda: sv.tonemap(np.zeros(3), curve=wrong),
        lambda: sv.Device(rays=wrong),
        lambda: reference.Settings(16, 0, wrong, "box", "conserving", False, 0),
    ):
        with pytest.raises(sv.SolariError, match=re.escape(repr(wrong)[:4])):
            choose()

"""What a proof measures must hold, and must fail with a seeded bug: shaders in which one function or constant is wrong.

A bug is anchored to a name, not to a line of text, so that only a rename of that function or constant touches it.
"""

import inspect
import re
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from solari_vk.gpu.shaders import compiler
from solari_vk.lab.shader_runner import ShaderRunner

GLSL = Path(__file__).resolve().parents[2] / "glsl"
KNOWN = []
"""Every bug of the modules imported so far; tests/test_seeded_bugs.py checks that each fits its shader."""


@dataclass(frozen=True)
class Rule:
    """A sentence that must hold, and its source: a document and a section of it."""

    name: str
    document: str = ""
    section: str = ""


@dataclass(frozen=True)
class Measurement:
    """A measured rule, which holds when `measured` is at most `bar`. `note` says where it is largest."""

    rule: Rule
    measured: float
    bar: float = 0.0
    unit: str = "wrong"
    note: str = ""

    @property
    def holds(self):
        """Whether `measured` is at most `bar`; false for NaN."""
        return self.measured <= self.bar

    def __str__(self):
        note = f": {self.note}" if self.note else ""
        return f"{self.rule.name}: {self.measured:.4g} {self.unit}, at most {self.bar:.4g}{note}"


def require(measurements):
    """Require that all measurements hold, and return them."""
    found = list(measurements)
    for measured in found:
        print(measured)
    assert found, "nothing was measured"
    assert not [str(measured) for measured in found if not measured.holds]
    return found


@dataclass(frozen=True)
class Bug:
    """A wrong function or constant of a shader file of glsl/.

    name: of a function, `name(type` where it is overloaded, or of a constant (`const` or `#define`).
    text: a function's new body, in which `correct(...)` calls the function as it was; a constant's new value.
    """

    file: str
    name: str
    text: str

    def __post_init__(self):
        KNOWN.append(self)

    def apply(self, source):
        """The shader with the bug. Raises ValueError unless exactly one function or constant has the name."""
        name, _, first = self.name.partition("(")
        # A constant's value may hold calls, whose parentheses nest twice at most.
        value = r"((?:[^,;()]|\((?:[^()]|\([^()]*\))*\))+)"  # up to the next constant of the statement
        constant = rf"\bconst\s+\w+\s[^;]*?\b{name}\s*=\s*{value}[,;]|^[ \t]*#define[ \t]+{name}[ \t]+(.+)$"
        constants = list(re.finditer(constant, source, re.M))
        functions = list(re.finditer(rf"^\w+ {name}(\(\s*{re.escape(first)}[^)]*\))\s*\{{", source, re.M))
        found = len(constants) + len(functions)
        if found != 1:
            raise ValueError(f"{self.file} must have one function or constant {self.name}, not {found}")
        if constants:
            start, end = constants[0].span(constants[0].lastindex)
            return source[:start] + self.text + source[end:]
        head = functions[0]
        end = _end_of_block(source, head.end())
        # The function as it was stays beside the wrong one under another name, so that the bug can call it.
        inner = f"{name}_without_bug"
        while inner in source:  # another bug of the same function
            inner += "s"
        body = re.sub(r"\bcorrect\(", f"{inner}(", self.text)
        original = re.sub(rf"\b{name}(?=\()", inner, source[head.start() : end], count=1)
        return f"{source[: head.start()]}{original}\n{head.group()} {body} }}{source[end:]}"


def _end_of_block(source, at):
    """The end of the block whose first brace is before `at`."""
    depth = 1
    while depth:
        depth += {"{": 1, "}": -1}.get(source[at], 0)
        at += 1
    return at


@contextmanager
def seeded(*bugs):
    """Compile all shaders with these bugs as long as the context is open."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for bug in bugs:
            roots = (folder, *compiler.overlays, GLSL)  # so that contexts nest, also in one file
            source = next(root / bug.file for root in roots if (root / bug.file).is_file())
            (folder / bug.file).parent.mkdir(parents=True, exist_ok=True)
            (folder / bug.file).write_text(bug.apply(source.read_text(encoding="utf-8")), encoding="utf-8")
        # Overlays come before the package's own folder, so that every pipeline made from now on has the bug.
        compiler.overlays.insert(0, folder)
        try:
            yield
        finally:
            compiler.overlays.remove(folder)


LOBES_ADDED = Bug(
    "scene/brdf.glsl",
    "evaluate_diffuse_brdf",
    "if (brdf_layering == LAYERING_FRESNEL_PRODUCT && wo.z > 0.0 && wi.z > 0.0) "
    "{ return brdf.diffuse.color * (INVERSE_PI * wi.z); } return correct(brdf, wo, wi);",
)
"""An earlier Solari: the BRDF adds its two lobes where layering is `fresnel_product`, as in Bevy 0.18."""


def with_shaders(proof, *arguments):
    """A check of a device: `proof(shaders, *arguments)` with the shaders beside the proof, in glsl/, compiled anew."""

    def check(device):
        with ShaderRunner(device, Path(inspect.getfile(proof)).parent / "glsl") as shaders:
            measured = proof(shaders, *arguments)
            return None if measured is None else list(measured)

    return check


def expect_noticed(bug, rule, check, *arguments):
    """Require that a proof fails with the bug: an assertion of `check`, or `rule` among what it measures."""

    def prove():
        measured = check(*arguments)
        if measured is not None:
            require([made for made in measured if made.rule == rule] if isinstance(rule, Rule) else measured)

    with seeded(bug), pytest.raises(AssertionError) as failed:
        prove()
    assert "nothing was measured" not in str(failed.value), "the proof measures nothing of this rule"


def bug_tests(bugs, quick=()):
    """A test for each rule that `check(device)` notices its bug; those that aren't `quick` are slow.

    `bugs` maps a rule of what `check` measures, or the name of what `check` asserts, to (check, bug).
    """
    cases = [
        pytest.param(rule, id=getattr(rule, "name", rule), marks=() if rule in quick else pytest.mark.slow)
        for rule in bugs
    ]

    @pytest.mark.parametrize("rule", cases)
    def test_a_seeded_bug_is_noticed(device, rule):
        check, bug = bugs[rule]
        expect_noticed(bug, rule, check, device)

    return test_a_seeded_bug_is_noticed

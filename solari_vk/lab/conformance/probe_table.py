"""The table of all probes, written by hand. Triangles lie in z = 0, so that t is the height of the ray's origin."""

from __future__ import annotations

import math
from typing import Any

from solari_vk.gpu.frame.ray_query_constants import RayFlags
from solari_vk.lab.conformance.probe_actions import (
    CONFIRM,
    CONFIRM_ODD,
    FARTHER,
    GENERATE_AT,
    GENERATE_SPHERE,
    NEARER,
    PASS_OVER,
    TERMINATE,
)
from solari_vk.lab.conformance.probes import (
    AABB,
    GENERATED,
    TRIANGLE,
    Expected,
    Probe,
    call_rule,
    flag_rule,
    hit_rule,
    instance_rule,
    ray_rule,
)

(
    FORCE_OPAQUE,
    FORCE_NO_OPAQUE,
    TERMINATE_ON_FIRST_HIT,
    SKIP_CLOSEST_HIT_SHADER,
    CULL_BACK_FACING,
    CULL_FRONT_FACING,
    CULL_OPAQUE,
    CULL_NO_OPAQUE,
    SKIP_TRIANGLES,
    SKIP_AABBS,
) = RayFlags
_HIT = Expected(TRIANGLE, 2.0)
_BACK_HIT = Expected(TRIANGLE, 2.0, front=False)
# From below, at the back of triangles.
_BELOW: dict[str, Any] = {"origin": (0.5, 0.25, -2.0), "direction": (0.0, 0.0, 1.0)}
# Down through the middle of the first unit box, whose top is 2 below the origin.
_DOWN: dict[str, Any] = {"origin": (0.5, 0.5, 3.0)}
# Through the three unit boxes, 1 before the first.
_ALONG_X: dict[str, Any] = {"origin": (-1, 0.5, 0.5), "direction": (1, 0, 0)}
_LAYERS = (2.0, 3.0, 4.0, 5.0)
_ANY_LAYER = Expected(TRIANGLE, None, primitive=None)


def _hits_at(t: float, more: int = 0) -> dict[str, Any]:
    """A probe's action in each box that its ray meets: to generate a hit at t."""
    return {"action": GENERATE_AT | more, "parameter": t}


_no_flag = flag_rule("no flag: opaque triangles are committed, others are candidates")
_force = flag_rule("FORCE_OPAQUE: all triangles are committed without being candidates")
_force_no = flag_rule("FORCE_NO_OPAQUE: all triangles are candidates")
_first = flag_rule("TERMINATE_ON_FIRST_HIT: the first committed hit ends the search")
_closest = flag_rule("SKIP_CLOSEST_HIT_SHADER: no effect on queries")
_back, _front = (flag_rule(f"CULL_{side.upper()}_FACING: {side} faces are not hit") for side in ("back", "front"))
_cull = flag_rule("CULL_OPAQUE: opaque geometry is not hit")
_cull_no = flag_rule("CULL_NO_OPAQUE: geometry that isn't opaque is not hit")
_no_triangles = flag_rule("SKIP_TRIANGLES: triangles are not hit")
_no_boxes = flag_rule("SKIP_AABBS: AABBs are neither candidates nor hit")

FLAGS = [
    # Opaque triangles are committed without a candidate; others are candidates until they are confirmed.
    Probe("opaque", _no_flag, "opaque", _HIT, action=PASS_OVER, candidates=0),
    Probe("glass passed over", _no_flag, "glass", None, action=PASS_OVER, candidate=_HIT, candidates=1),
    Probe("glass confirmed", _no_flag, "glass", _HIT, candidate=_HIT, candidates=1),
    Probe(
        # The glass lies 1 above the opaque triangle of the same instance.
        "glass before opaque",
        _no_flag,
        "glass over opaque",
        Expected(TRIANGLE, 2.0, geometry=1),
        candidates=1,
        candidate=Expected(TRIANGLE, 2.0, geometry=1),
    ),
    Probe("through glass", _no_flag, "glass over opaque", Expected(TRIANGLE, 3.0), action=PASS_OVER),
    Probe("beside", _no_flag, "opaque", None, origin=(1.5, 1.25, 2.0), candidates=0),
    Probe("away", _no_flag, "opaque", None, direction=(0.0, 0.0, 1.0), candidates=0),
    Probe("forced glass", _force, "glass", _HIT, flags=FORCE_OPAQUE, action=PASS_OVER, candidates=0),
    Probe("forced stack", _force, "glass stack", _HIT, flags=FORCE_OPAQUE, action=PASS_OVER, candidates=0),
    # Flags of the ray win over those of the instance, which win over those of the geometry.
    Probe("forced over instance", _force, "made glass", _HIT, flags=FORCE_OPAQUE, action=PASS_OVER, candidates=0),
    Probe(
        "unforced opaque passed",
        _force_no,
        "opaque",
        None,
        flags=FORCE_NO_OPAQUE,
        action=PASS_OVER,
        candidate=_HIT,
        candidates=1,
    ),
    Probe("unforced opaque confirmed", _force_no, "opaque", _HIT, flags=FORCE_NO_OPAQUE, candidate=_HIT, candidates=1),
    Probe(
        "unforced over instance",
        _force_no,
        "made opaque",
        None,
        flags=FORCE_NO_OPAQUE,
        action=PASS_OVER,
        candidate=_HIT,
        candidates=1,
    ),
    # Any of the layers may come first: the order of traversal is the driver's.
    Probe("first of a wall", _first, "wall", _ANY_LAYER, flags=TERMINATE_ON_FIRST_HIT, among=_LAYERS, candidates=0),
    Probe(
        "first confirmed", _first, "glass stack", _ANY_LAYER, flags=TERMINATE_ON_FIRST_HIT, among=_LAYERS, candidates=1
    ),
    Probe(
        "first of boxes",
        _first,
        "boxes",
        Expected(GENERATED, None, primitive=None),
        flags=TERMINATE_ON_FIRST_HIT,
        action=GENERATE_SPHERE,
        among=(1.0, 3.0, 5.0),
        **_ALONG_X,
    ),
    Probe(
        # A generated hit may lie outside of its box; it still ends the search.
        "first of boxes, hit beyond them",
        _first,
        "boxes",
        Expected(GENERATED, 50.0, primitive=None),
        flags=TERMINATE_ON_FIRST_HIT,
        **_hits_at(50.0),
        candidates=1,
        **_ALONG_X,
    ),
    Probe(
        "all boxes, hit beyond them",
        _first,
        "boxes",
        Expected(GENERATED, 50.0, primitive=None),
        **_hits_at(50.0),
        candidates=3,
        **_ALONG_X,
    ),
    Probe(
        "nothing confirmed", _first, "glass stack", None, flags=TERMINATE_ON_FIRST_HIT, action=PASS_OVER, candidates=4
    ),
    # Queries have no closest-hit shader, so that the flag must change nothing.
    Probe("no closest hit shader", _closest, "opaque", _HIT, flags=SKIP_CLOSEST_HIT_SHADER, candidates=0),
    Probe("no closest hit shader, back", _closest, "opaque", _BACK_HIT, flags=SKIP_CLOSEST_HIT_SHADER, **_BELOW),
    Probe("no closest hit shader, glass", _closest, "glass", _HIT, flags=SKIP_CLOSEST_HIT_SHADER, candidates=1),
    Probe("no flag from the back", _back, "opaque", _BACK_HIT, **_BELOW),
    Probe("back faces culled, front", _back, "opaque", _HIT, flags=CULL_BACK_FACING),
    Probe("back faces culled, back", _back, "opaque", None, flags=CULL_BACK_FACING, **_BELOW),
    Probe("back faces culled, glass", _back, "glass", None, flags=CULL_BACK_FACING, candidates=0, **_BELOW),
    Probe("front faces culled, front", _front, "opaque", None, flags=CULL_FRONT_FACING),
    Probe("front faces culled, back", _front, "opaque", _BACK_HIT, flags=CULL_FRONT_FACING, **_BELOW),
    Probe("opaque culled", _cull, "opaque", None, flags=CULL_OPAQUE, candidates=0),
    Probe("opaque culled, glass", _cull, "glass", _HIT, flags=CULL_OPAQUE, candidates=1),
    Probe("opaque culled, made opaque", _cull, "made opaque", None, flags=CULL_OPAQUE, candidates=0),
    Probe("opaque culled, both", _cull, "glass over opaque", None, flags=CULL_OPAQUE, action=PASS_OVER, candidates=1),
    Probe(
        "opaque culled, boxes",
        _cull,
        "opaque boxes",
        None,
        **_DOWN,
        flags=CULL_OPAQUE,
        action=GENERATE_SPHERE,
        candidates=0,
    ),
    Probe("glass culled", _cull_no, "glass", None, flags=CULL_NO_OPAQUE, candidates=0),
    Probe("glass culled, opaque", _cull_no, "opaque", _HIT, flags=CULL_NO_OPAQUE, candidates=0),
    Probe("glass culled, made glass", _cull_no, "made glass", None, flags=CULL_NO_OPAQUE, candidates=0),
    Probe("glass culled, both", _cull_no, "glass over opaque", Expected(TRIANGLE, 3.0), flags=CULL_NO_OPAQUE),
    Probe("triangles skipped", _no_triangles, "opaque", None, flags=SKIP_TRIANGLES, candidates=0),
    Probe(
        "triangles skipped, boxes",
        _no_triangles,
        "boxes",
        Expected(GENERATED, 2.0),
        **_DOWN,
        flags=SKIP_TRIANGLES,
        action=GENERATE_SPHERE,
    ),
    Probe("boxes skipped", _no_boxes, "boxes", None, **_DOWN, flags=SKIP_AABBS, action=GENERATE_SPHERE, candidates=0),
    Probe("boxes skipped, triangle", _no_boxes, "opaque", _HIT, flags=SKIP_AABBS),
]

# Instance masks have eight bits; a ninth one of a ray must be ignored.
_mask = ray_rule("cull_mask: hit when it shares a bit with the instance's mask")
MASKS = [
    Probe("same bit", _mask, "mask 01", _HIT, mask=0x01),
    Probe("other bit", _mask, "mask 01", None, mask=0x02),
    Probe("all but the bit", _mask, "mask 01", None, mask=0xFE),
    Probe("top bit", _mask, "mask 80", _HIT, mask=0x80),
    Probe("all but the top bit", _mask, "mask 80", None, mask=0x7F),
    Probe("one of several", _mask, "mask 5A", _HIT, mask=0x12),
    Probe("none of several", _mask, "mask 5A", None, mask=0xA5),
    Probe("instance without bits", _mask, "mask 00", None, mask=0xFF),
    Probe("ray without bits", _mask, "opaque", None, mask=0x00),
    Probe("bits beyond eight", _mask, "opaque", None, mask=0x100),
]

# Both ends of the range are excluded.
_least, _most = ray_rule("t_min: only points beyond it"), ray_rule("t_max: only points before it")
_scale = ray_rule("dir: t is in units of its length")
# Far more than the rounding of t, far less than anything else.
_EDGE = 1e-5
RANGE = [
    Probe("just beyond t_min", _least, "opaque", _HIT, t_min=2 - _EDGE),
    Probe("just before t_min", _least, "opaque", None, t_min=2 + _EDGE),
    Probe("at t_min", _least, "opaque", None, t_min=2.0),
    Probe("glass at t_min", _least, "glass", None, t_min=2.0, candidates=0),
    # Layers are 1 apart: the range begins between two of them.
    Probe("second layer by t_min", _least, "wall", Expected(TRIANGLE, 3.0, primitive=1), t_min=2.5),
    Probe("last layer by t_min", _least, "glass stack", Expected(TRIANGLE, 5.0, primitive=3), t_min=4.5, candidates=1),
    Probe("just before t_max", _most, "opaque", _HIT, t_max=2 + _EDGE),
    Probe("just beyond t_max", _most, "opaque", None, t_max=2 - _EDGE),
    Probe("at t_max", _most, "opaque", None, t_max=2.0),
    Probe("glass at t_max", _most, "glass", None, t_max=2.0, candidates=0),
    Probe("infinite t_max", _most, "opaque", _HIT, t_max=math.inf),
    Probe("nothing between", _most, "wall", None, t_min=2.25, t_max=2.75),
    Probe("two layers between", _most, "glass stack", None, t_min=2.5, t_max=4.5, action=PASS_OVER, candidates=2),
    Probe("box beyond t_max", _most, "boxes", None, **_DOWN, t_max=1.9, action=GENERATE_SPHERE),
    Probe("twice as long", _scale, "opaque", Expected(TRIANGLE, 1.0), direction=(0, 0, -2)),
    # A direction of another length changes t, not the point that is hit.
    Probe("thousandth", _scale, "opaque", Expected(TRIANGLE, 2048.0), direction=(0, 0, -1 / 1024), t_max=1e4),
    Probe("thousand", _scale, "opaque", Expected(TRIANGLE, 2 / 1024), direction=(0, 0, -1024)),
    Probe("slanted", _scale, "opaque", Expected(TRIANGLE, 0.5), origin=(2.5, 1.25, 2.0), direction=(-4, -2, -4)),
    Probe("range of a long ray", _scale, "opaque", None, direction=(0, 0, -2), t_max=0.9),
]

_facing = instance_rule("TRIANGLE_FLIP_FACING swaps front and back, which transforms do not")
_two = instance_rule("TRIANGLE_FACING_CULL_DISABLE: both faces are hit")
_override = instance_rule("FORCE_OPAQUE and FORCE_NO_OPAQUE of an instance override its geometry")
_active = instance_rule("an instance without a structure is never hit")
INSTANCE_FLAGS = [
    Probe("flipped", _facing, "flipped", _BACK_HIT),
    Probe("flipped, back faces culled", _facing, "flipped", None, flags=CULL_BACK_FACING),
    Probe("flipped, front faces culled", _facing, "flipped", _BACK_HIT, flags=CULL_FRONT_FACING),
    # The face is that of object space: a transform that mirrors does not swap it.
    Probe("mirrored instance", _facing, "mirrored", _HIT, flags=CULL_BACK_FACING),
    Probe("mirrored instance from the back", _facing, "mirrored", _BACK_HIT, flags=CULL_FRONT_FACING, **_BELOW),
    Probe("inverted instance", _facing, "inverted", _HIT, flags=CULL_BACK_FACING),
    Probe("flipped and mirrored", _facing, "flipped mirrored", _BACK_HIT),
    # The transform of a geometry is applied before, and does swap it.
    Probe("mirrored geometry", _facing, "mirrored geometry", _BACK_HIT, origin=(1.5, 0.25, 2.0)),
    Probe("not culled from the back", _two, "two-sided", _BACK_HIT, flags=CULL_BACK_FACING, **_BELOW),
    Probe("not culled from the front", _two, "two-sided", _HIT, flags=CULL_FRONT_FACING),
    Probe("glass made opaque", _override, "made opaque", _HIT, action=PASS_OVER, candidates=0),
    Probe("opaque made glass", _override, "made glass", None, action=PASS_OVER, candidate=_HIT, candidates=1),
    Probe("stack made opaque", _override, "opaque stack", _HIT, action=PASS_OVER, candidates=0),
    Probe("inactive", _active, "inactive", None, candidates=0),
]

_index = hit_rule("instance_index, instance_custom_data, sbt_record_offset")
_place = hit_rule("geometry_index, primitive_index")
_moved = hit_rule("object_to_world, world_to_object of moved, rotated, mirrored and sheared instances")
GETTERS = [
    # Instance fields of 24 bits share words with masks and flags of 8 bits.
    Probe("24 bits", _index, "all bits", _HIT),
    Probe("top and lowest bit", _index, "top bit", _HIT),
    Probe("no bit", _index, "zero", _HIT),
    Probe("record offset", _index, "record offset", _HIT),
    Probe("first geometry", _place, "many", _HIT),
    Probe("second geometry", _place, "many", Expected(TRIANGLE, 2.0, 1), origin=(2.5, 0.25, 2.0)),
    Probe(
        "second geometry, second triangle",
        _place,
        "many",
        Expected(TRIANGLE, 3.0, 1, 1),
        origin=(2.5, 0.25, 2.0),
        t_min=2.5,
    ),
    # The third geometry has a transform, which moves it by (4, 0, 0.5).
    Probe("third geometry", _place, "many", Expected(TRIANGLE, 1.5, 2), origin=(4.5, 0.25, 2.0)),
    Probe(
        "third geometry, third triangle",
        _place,
        "many",
        Expected(TRIANGLE, 3.5, 2, 2),
        origin=(4.5, 0.25, 2.0),
        t_min=3.0,
    ),
    Probe(
        "third triangle from below",
        _place,
        "many",
        Expected(TRIANGLE, 0.5, 2, 2, front=False),
        origin=(4.5, 0.25, -2.0),
        direction=(0, 0, 1),
    ),
    Probe(
        "second list of boxes",
        _place,
        "two lists of boxes",
        Expected(GENERATED, 1.5, 1, 1),
        origin=(2.5, 2.5, 2.5),
        **_hits_at(1.5),
    ),
    *(
        Probe(label, _moved, label, Expected(TRIANGLE, 2.0), origin=(0.3, 0.9, 2.0), direction=(0.1, -0.2, -1.0))
        for label in ("mirrored", "turned", "stretched", "sheared", "inverted", "tiny")
    ),
    Probe("sheared candidate", _moved, "sheared", _HIT, flags=FORCE_NO_OPAQUE, candidate=_HIT, candidates=1),
    Probe("inverted candidate", _moved, "inverted", _HIT, flags=FORCE_NO_OPAQUE, candidate=_HIT, candidates=1),
]

_generate = call_rule("rayQueryGenerateIntersection commits a hit that is the nearest so far")
_candidate = call_rule("rayQueryProceed stops at each AABB, opaque or not")
_confirm, _end = (
    call_rule("rayQueryConfirmIntersection commits the candidate triangle"),
    call_rule("rayQueryTerminate ends the search and keeps what is committed"),
)
_BALL = 2.5 - math.sqrt(3) / 4  # 0.25 beside the center of a ball of radius 0.5
CALLS = [
    Probe("box passed over", _candidate, "boxes", None, action=PASS_OVER, candidate=Expected(AABB, None), **_DOWN),
    Probe("opaque box", _candidate, "opaque boxes", None, action=PASS_OVER, candidate=Expected(AABB, None), **_DOWN),
    Probe(
        "opaque box by the ray",
        _candidate,
        "boxes",
        None,
        action=PASS_OVER,
        flags=FORCE_OPAQUE,
        candidate=Expected(AABB, None),
        **_DOWN,
    ),
    Probe("generated at 2.25", _generate, "boxes", Expected(GENERATED, 2.25), **_hits_at(2.25), **_DOWN),
    Probe(
        "generated before a wall", _generate, "boxes over a wall", Expected(GENERATED, 2.25), **_hits_at(2.25), **_DOWN
    ),
    Probe(
        "generated behind a wall",
        _generate,
        "wall in boxes",
        Expected(TRIANGLE, 2.5),
        origin=(0.5, 0.5, 2.5),
        **_hits_at(2.75),
    ),
    *(
        Probe(label, _generate, "boxes", Expected(GENERATED, t, primitive=None), **action, candidates=3, **_ALONG_X)
        for label, t, action in (
            ("generated ever nearer", 48.0, _hits_at(50.0, NEARER)),
            ("generated ever farther", 50.0, _hits_at(50.0, FARTHER)),
        )
    ),
    Probe("generated in an opaque box", _generate, "opaque boxes", Expected(GENERATED, 2.5), **_hits_at(2.5), **_DOWN),
    Probe("ball", _generate, "boxes", Expected(GENERATED, 2.0), action=GENERATE_SPHERE, **_DOWN),
    Probe(
        "ball beside its middle",
        _generate,
        "boxes",
        Expected(GENERATED, _BALL),
        origin=(0.5, 0.75, 3.0),
        action=GENERATE_SPHERE,
    ),
    Probe("past the ball, in its box", _generate, "boxes", None, origin=(0.03, 0.03, 3.0), action=GENERATE_SPHERE),
    Probe("closest of three balls", _generate, "boxes", Expected(GENERATED, 1.0), action=GENERATE_SPHERE, **_ALONG_X),
    Probe(
        "closest from the other side",
        _generate,
        "boxes",
        Expected(GENERATED, 2.0, primitive=2),
        origin=(7, 0.5, 0.5),
        direction=(-1, 0, 0),
        action=GENERATE_SPHERE,
    ),
    Probe(
        "from inside a ball",
        _generate,
        "boxes",
        Expected(GENERATED, 0.5),
        origin=(0.5, 0.5, 0.5),
        action=GENERATE_SPHERE,
    ),
    Probe(
        "turned and stretched balls",
        _generate,
        "turned boxes",
        Expected(GENERATED, _BALL),
        origin=(0.75, 0.5, 3.0),
        action=GENERATE_SPHERE,
    ),
    Probe("closest confirmed", _confirm, "glass stack", _HIT),
    Probe(
        "closest odd one confirmed", _confirm, "glass stack", Expected(TRIANGLE, 3.0, primitive=1), action=CONFIRM_ODD
    ),
    Probe("none confirmed", _confirm, "glass stack", None, action=PASS_OVER, candidates=4),
    Probe("odd one before an opaque", _confirm, "glass over opaque", Expected(TRIANGLE, 3.0), action=CONFIRM_ODD),
    Probe("ended at once", _end, "glass stack", None, action=TERMINATE, candidates=1),
    Probe(
        "confirmed and ended", _end, "glass stack", _ANY_LAYER, action=CONFIRM | TERMINATE, among=_LAYERS, candidates=1
    ),
    Probe("generated and ended", _end, "boxes", Expected(GENERATED, 2.25), **_hits_at(2.25, TERMINATE), **_DOWN),
    Probe(
        "generated beyond the boxes and ended",
        _end,
        "boxes",
        Expected(GENERATED, 50.0, primitive=None),
        **_hits_at(50.0, TERMINATE),
        candidates=1,
        **_ALONG_X,
    ),
]

PROBES: list[Probe] = [*FLAGS, *MASKS, *RANGE, *INSTANCE_FLAGS, *GETTERS, *CALLS]

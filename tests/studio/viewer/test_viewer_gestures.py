"""Moving, turning, scaling and duplicating by keys, picking by a box, and views: with made-up events."""

from __future__ import annotations

import glfw
import numpy as np
import pytest
from viewer_tools import press, release

import solari_vk as sv
from solari_vk.studio.viewer.actions import SIDES, act
from solari_vk.studio.viewer.controls import NUMBER_PAD, Controls
from solari_vk.studio.viewer.markers import project
from solari_vk.studio.viewer.new_objects import SHAPES
from solari_vk.studio.viewer.outline import shares_within
from solari_vk.studio.viewer.status import state_in_words
from solari_vk.studio.viewer.window import Event

LEFT, RIGHT = glfw.MOUSE_BUTTON_LEFT, glfw.MOUSE_BUTTON_RIGHT
PLACES = ("short block", "tall block")


@pytest.fixture
def use(session):
    """A function that handles events as the viewer does: events, and texts whose characters are typed."""
    controls = Controls(
        session.camera_control,
        lambda name, argument: (setattr(session, "cursor", controls.cursor), act(session, name, argument))[1],
        lambda: session.layout.picture,
        lambda: session.gesture,
    )

    def handle(*events):
        for event in events:
            typed = [Event("text", ord(character)) for character in event] if isinstance(event, str) else [event]
            controls.handle(typed)

    return handle


@pytest.fixture
def block(session, scene):
    session.selected = scene.instances["short block"]
    return session.selected


def move(x, y):
    return Event("cursor", x=x, y=y)


def click(code, modifiers=0):
    return [Event("button", code, True, modifiers), Event("button", code, False, modifiers)]


KEY_G, KEY_R, KEY_S, KEY_D = press(glfw.KEY_G), press(glfw.KEY_R), press(glfw.KEY_S), press(glfw.KEY_D, glfw.MOD_SHIFT)
ENTER, ESCAPE = press(glfw.KEY_ENTER), press(glfw.KEY_ESCAPE)


def test_grabbing_with_axis_and_number_is_one_edit(session, block, use):
    before = block.transform
    use(move(300, 150), KEY_G, "gx", move(320, 160), "-0.75")
    assert "move [-0.75] m along X" in state_in_words(session)
    assert block.position - before[:3, 3] == pytest.approx((-0.75, 0, 0)), "seen while it is typed"
    assert not session.history.done
    use(ENTER)
    assert (session.gesture, [edit.text for edit in session.history.done]) == (None, ["moving Instance 'short block'"])
    act(session, "undo")
    assert (block.transform == before).all()
    act(session, "redo")
    assert block.position - before[:3, 3] == pytest.approx((-0.75, 0, 0))


@pytest.mark.parametrize("how", [[ESCAPE], click(RIGHT)])
@pytest.mark.parametrize("begins", [KEY_G, KEY_R, KEY_S, KEY_D])
def test_cancelling_leaves_everything_as_it_was(session, scene, block, use, how, begins):
    session.edit(block, visible=False)
    act(session, "undo")
    before, count = block.transform, len(scene.instances)
    use(move(300, 150), begins, move(350, 190))
    moved = session.selected.transform
    assert (moved != before).any()
    use(*how)
    assert (session.gesture, session.picked, len(scene.instances)) == (None, [block], count)
    assert (block.transform == before).all()
    assert (session.history.done, len(session.history.undone)) == ([], 1), "what was undone can still be done again"
    assert not session.window.wants_to_close
    assert session.question is None


def test_the_cursor_moves_and_a_click_keeps(session, block, use):
    middle = block.mesh.positions.astype(np.float64).min(axis=0) / 2 + block.mesh.positions.max(axis=0) / 2
    at = project(session.camera, middle[None], session.layout.picture)[0]
    goal = at + np.array((30, -20))
    use(move(*at), KEY_G, move(*goal))
    assert session.history.done == []
    use(*click(LEFT))
    moved = project(session.camera, middle[None] + block.position, session.layout.picture)[0]
    assert moved == pytest.approx(goal)
    assert len(session.history.done) == 1
    assert session.selected is block, "the click picks nothing"
    use(KEY_R, "y90", ENTER, KEY_S, "2", ENTER)
    assert block.scale == pytest.approx([2] * 3)
    assert block.rotation @ (0, 0, 1) == pytest.approx((1, 0, 0))
    assert [edit.text.split()[0] for edit in session.history.done] == ["moving", "turning", "scaling"]
    use(KEY_G, ENTER)
    assert len(session.history.done) == 3, "nothing moved"


@pytest.mark.parametrize(("low", "kept"), [((-1, 0, -1), (0, 0, 0)), ((4, 0, 4), (5, 1, 5))])
def test_what_stands_on_its_origin_keeps_it(session, scene, use, low, kept):
    """And what lies beside its origin grows about its middle."""
    box = session.selected = scene.add(sv.shapes.box(low, np.add(low, 2)))
    use(KEY_S, *"0.5", ENTER)
    assert box.transform @ (*kept, 1) == pytest.approx((*kept, 1))
    assert box.scale == pytest.approx([0.5] * 3)


def test_keys_switch_what_is_done_and_correct_what_is_typed(session, block, use):
    before = block.transform
    use(move(300, 150), KEY_G, "g5", press(glfw.KEY_BACKSPACE), "2", press(glfw.KEY_TAB), "3")
    assert block.position - before[:3, 3] == pytest.approx((2, 3, 0))
    use(KEY_R, "Y")
    assert (block.transform[:3, 3] == before[:3, 3]).all(), "from the start"
    use(move(300, 150), press(glfw.KEY_LEFT_CONTROL), move(340, 190))
    assert session.gesture.transforming.snaps
    use(release(glfw.KEY_LEFT_CONTROL), press(glfw.KEY_LEFT_SHIFT, glfw.MOD_SHIFT), move(380, 190))
    assert not session.gesture.transforming.snaps
    use(release(glfw.KEY_LEFT_SHIFT), KEY_S, "0.5", press(glfw.KEY_KP_ENTER))
    assert block.scale == pytest.approx([0.5] * 3)
    assert not session.camera_control.pressed
    assert not session.camera_control.fast


def test_refused_places_are_said_and_the_last_one_stays(session, block, use):
    before = block.transform
    use(KEY_G, "1000000000000000")
    assert "short block" in session.message
    assert 1 < block.position[0] < 1e15
    use(*[press(glfw.KEY_BACKSPACE)] * 5)
    assert session.message == ""
    use(ESCAPE, KEY_S, "-0")
    assert "area" in session.message
    use(".5")
    assert (session.message, block.scale) == ("", pytest.approx([0.5] * 3))
    use(ESCAPE)
    assert (block.transform == before).all()


def test_several_move_and_turn_about_their_middle(session, scene, use):
    blocks = [scene.instances[name] for name in PLACES]
    lamp = scene.add(sv.SpotLight((1, 1.5, 1), (0, 0, -1)))
    session.pick_only([lamp, *blocks])
    camera = scene.cameras[0]
    session.pick_also(camera)
    before = [item.position.copy() for item in session.picked]
    use(KEY_G, "z-1", ENTER)
    for item, at in zip(session.picked, before, strict=True):
        assert item.position - at == pytest.approx((0, 0, -1), abs=1e-6)
    use(KEY_R, "y90", ENTER)
    assert lamp.direction == pytest.approx((-1, 0, 0), abs=1e-6)
    size = blocks[0].scale
    use(KEY_S, "2", ENTER)
    assert blocks[0].scale == pytest.approx(2 * size)
    assert np.linalg.norm(camera.transform[:3, 0]) == pytest.approx(1), "a camera has no size"
    for _ in range(3):
        act(session, "undo")
    for item, at in zip(session.picked, before, strict=True):
        assert item.position == pytest.approx(at)


def test_duplicates_share_their_material_until_they_get_their_own(session, scene, block, use):
    count = len(scene.instances)
    use(move(300, 150), KEY_D, "x1", ENTER)
    copy = session.selected
    assert (len(scene.instances), copy.name, copy.material, copy.mesh) == (
        count + 1,
        "short block 2",
        block.material,
        block.mesh,
    )
    assert copy.position - block.position == pytest.approx((1, 0, 0))
    assert len(session.history.done) == 1
    use(KEY_D, ENTER)
    assert session.selected.name == "short block 3"
    act(session, "undo")
    session.selected = copy
    act(session, "own_material")
    assert copy.material is not block.material
    session.edit(copy.material, base_color=(1, 0, 0))
    assert tuple(block.material.base_color) != (1, 0, 0)
    for _ in range(3):
        act(session, "undo")
    assert len(scene.instances) == count
    assert copy not in scene.instances
    act(session, "redo")
    assert copy in scene.instances
    assert copy.position - block.position == pytest.approx((1, 0, 0))
    scene.environment = sv.Sky()
    session.selected = scene.environment
    use(KEY_D)
    assert (session.gesture, session.message) == (None, "what surrounds the scene is there once")


def test_s_and_shift_d_fly_where_nothing_is_picked_and_during_flights(session, scene, use):
    pressed = session.camera_control.pressed
    use(KEY_S, KEY_D)
    assert pressed == {"back", "right"}
    use(release(glfw.KEY_S), release(glfw.KEY_D))
    session.selected = scene.instances["short block"]
    use(press(glfw.KEY_W), KEY_S, release(glfw.KEY_S), release(glfw.KEY_W))
    assert (session.gesture, pressed) == (None, set())
    use(Event("button", RIGHT, True), KEY_S)
    assert pressed == {"back"}
    use(release(glfw.KEY_S), Event("button", RIGHT, False), press(glfw.KEY_W), KEY_G, release(glfw.KEY_W))
    assert (session.gesture is not None, pressed) == (True, set()), "a flight ends during a gesture"
    session.locked.add(session.selected)
    use(ESCAPE, KEY_S)
    assert (session.gesture, pressed) == (None, {"back"})


def test_a_file_or_closing_ends_a_gesture(session, block, use):
    before = block.transform
    use(KEY_G, "1", Event("close"))
    assert (session.gesture, session.window.wants_to_close) == (None, True)
    assert (block.transform == before).all()


# ---- picking by a box -------------------------------------------------------------------------------


class Seen:
    """Stands for pictures of 8 x 4 pixels: a floor (1) with an object (2) on it."""

    ready = True
    mode = "reference"
    camera = sv.Camera()

    def __init__(self, floor, item):
        numbers = np.full((4, 8), 1, np.uint32)
        numbers[1:3, 2:4] = 2
        numbers[0] = 0xFFFFFFFF
        self.binder = type("Binder", (), {"instances": {1: floor, 2: item}})
        self.reference = type("Reference", (), {"tracer": {"instance_id": numbers}})


def test_a_box_picks_what_is_mostly_in_it(session, scene, use):
    floor, item = scene.instances["room"], scene.instances["short block"]
    seen = Seen(floor, item)
    assert shares_within(seen, (0, 0), (1, 1)) == {floor: 1, item: 1}
    assert shares_within(seen, (0.25, 0.25), (0.5, 0.51)) == {floor: 0, item: 1}
    assert shares_within(seen, (-1, -1), (0.3, 9)) == {floor: pytest.approx(7 / 20), item: 0.5}
    session.pictures.__dict__.update(
        ready=True, mode="reference", camera=seen.camera, binder=seen.binder, reference=seen.reference
    )
    width, height = session.layout.picture.width, session.layout.picture.height
    box = [move(0.6 * width, 0.9 * height), press(glfw.KEY_B), *click(LEFT)[:1], move(0.2 * width, 0.2 * height)]
    use(*box, Event("button", LEFT, False))
    assert session.picked == [item]
    session.selected = other = scene.instances["lamp"]
    use(move(10, 340), Event("button", LEFT, True, glfw.MOD_CONTROL), move(300, 10))
    assert session.gesture.corners == ((10, 10), (300, 340))
    use(Event("button", LEFT, False, glfw.MOD_SHIFT))
    assert session.picked == [other, item]
    use(*box, ESCAPE)
    assert (session.gesture, session.picked) == (None, [other, item])
    use(press(glfw.KEY_B), *click(LEFT))
    assert session.picked == [other, item], "a click picks nothing"
    session.locked.add(item)
    use(press(glfw.KEY_A, glfw.MOD_CONTROL))
    assert session.picked == [scene.cameras[0], *(each for each in scene.instances if each is not item)]


# ---- views and new shapes ---------------------------------------------------------------------------


@pytest.mark.parametrize("alt", [False, True])
def test_the_number_pad_shows_sides(session, use, alt):
    control = session.camera_control
    center, distance = control.center, control.distance

    def type_digit(number, modifiers=0):
        code = (glfw.KEY_0 if alt else glfw.KEY_KP_0) + number
        use(press(code, modifiers | (glfw.MOD_ALT if alt else 0)), release(code))

    places = {(1, 0): (0, 0, 1), (3, 0): (1, 0, 0), (7, 0): (0, 1, 0)}
    for (number, _), side in places.items():
        for modifiers, sign in ((0, 1), (glfw.MOD_CONTROL, -1)):
            type_digit(number, modifiers)
            assert control.camera.position == pytest.approx(center + sign * distance * np.array(side))
            assert control.center == pytest.approx(center)
            assert np.linalg.det(control.camera.transform[:3, :3]) == pytest.approx(1)
    type_digit(1)
    height = control.seen_height
    type_digit(6)
    type_digit(8)
    assert (control.camera.position - center)[:2].min() > 0, "to the right, and up"
    type_digit(5)
    assert control.camera.orthographic_height == pytest.approx(height)
    type_digit(5)
    assert (control.camera.orthographic_height, control.seen_height) == (0, pytest.approx(height))
    assert control.center == pytest.approx(center)
    type_digit(0)
    assert (control.camera.transform == control.home.transform).all()
    assert {name for name, _ in NUMBER_PAD.values()} == {"look_from", "orbit", "orthographic", "focus", "reset"}
    assert {side for name, side in NUMBER_PAD.values() if name == "look_from"} == set(SIDES)


@pytest.mark.parametrize("kind", SHAPES)
def test_new_shapes_stand_where_the_camera_looks(session, scene, kind):
    count = len(scene.instances)
    act(session, "add_shape", kind)
    made = session.selected
    assert made is scene.instances[-1]
    low, high = sv.Scene(made).bounds
    assert low[1] == pytest.approx(session.camera_control.center[1], abs=1e-6)
    assert 0.05 < np.ptp((low, high), axis=0).max() / session.camera_control.seen_height < 0.5
    act(session, "undo")
    assert len(scene.instances) == count

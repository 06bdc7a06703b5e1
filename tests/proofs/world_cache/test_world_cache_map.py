"""The world cache's hash map, compaction, lifetimes and blend against dict and numpy."""

import numpy as np
import pytest
from cache_frames import QUERY, SIZE, MapFrame
from oracles.encodings import pcg4d, pcg_hash
from support.seeded_bugs import Bug, bug_tests

from solari_vk.bound.constants import NO_INDEX

NORMALS = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, 0, -1), (0.6, 0.64, 0.48), (-0.6, 0.64, -0.48)], np.float32)
SIZES = np.array((0.25, 0.5), np.float32)


def make_queries(key_count, query_count, seed=0):
    """Random queries of `key_count` cells, about equally many of each, in random order; and the index of each query's
    cell."""
    random = np.random.default_rng(seed)
    side = 11
    cell = np.concatenate([np.arange(key_count), random.integers(0, key_count, query_count - key_count)])
    random.shuffle(cell)
    normal = cell % 6
    size = cell // 6 % 2
    place = cell // 12
    corner = np.stack([place % side, place // side % side, place // side**2], axis=1) - side // 2
    queries = np.zeros(query_count, QUERY)
    queries["cell_size"] = SIZES[size]
    queries["normal"] = NORMALS[normal]
    queries["position"] = (corner + random.uniform(0.01, 0.99, (query_count, 3))) * queries["cell_size"][:, None]
    queries["rng"] = random.integers(1, 2**32, query_count)
    queries["life"] = random.integers(1, 10, query_count)
    return queries, cell


def expected_keys(queries):
    """The entry at which each query's search begins (before the modulo), and the key's checksum."""
    position = np.floor(queries["position"] / queries["cell_size"][:, None]).astype(np.int32)
    normal = np.floor(queries["normal"] + 1e-4).astype(np.int32) @ np.array((1, 3, 9), np.int32)
    kind = pcg_hash(queries["cell_size"].view(np.uint32)) + normal.view(np.uint32)
    hashed = pcg4d(np.concatenate([position.view(np.uint32), kind[:, None]], axis=1))
    return hashed[:, 0], np.maximum(hashed[:, 1], 1)


# ---- the map ----------------------------------------------------------------------------------------


def test_map(device):
    """Many threads insert few cells into a nearly full map: each cell exists once, where a search for its key ends."""
    cells, keys = 1024, 800
    queries, cell = make_queries(keys, 20_000)
    with MapFrame(device, cells, queries, world_cache_search_steps=64) as frame:
        answers = frame.run()["answers"]
        checksums = frame["checksums"]
        bounds = frame["bounds"]
        life = frame["life"]
    first, checksum = expected_keys(queries)
    np.testing.assert_array_equal(answers["first"], first)
    np.testing.assert_array_equal(answers["checksum"], checksum)
    assert (answers["cell"] != NO_INDEX).all()
    place = {}
    for number, at in zip(cell, answers["cell"], strict=True):
        assert place.setdefault(number, at) == at, "one key has two entries"
    assert len(set(place.values())) == keys == np.count_nonzero(checksums), "two keys share an entry"
    np.testing.assert_array_equal(checksums[answers["cell"]], checksum)
    away = (answers["cell"] - first) % cells
    assert away.max() < 64
    assert (answers["cell"] < first % cells).any(), "no search wrapped around the end of the map"
    corner = np.floor(queries["position"] / queries["cell_size"][:, None]) * queries["cell_size"][:, None]
    np.testing.assert_array_equal(bounds[answers["cell"], :3], corner)
    np.testing.assert_array_equal(bounds[answers["cell"], 3], queries["cell_size"])
    longest = np.zeros(cells, int)
    np.maximum.at(longest, answers["cell"], queries["life"])
    np.testing.assert_array_equal(life, longest)


def test_a_surface_on_a_plane_of_the_grid_has_one_side(device):
    """Where rounding moves points across the plane, and normals along an axis off it."""
    random = np.random.default_rng(0)
    queries, _ = make_queries(1, 1000)
    queries["cell_size"], queries["normal"] = 0.25, (0, 1, 0)
    queries["position"] = random.uniform(0.01, 0.24, (1000, 3))
    queries["position"][:, 1] = 0.5 + random.uniform(-1e-6, 1e-6, 1000)
    queries["normal"] += random.uniform(-1e-6, 1e-6, (1000, 3)).astype(np.float32)
    with MapFrame(device, 1024, queries) as frame:
        (cell,) = set(frame.run()["answers"]["cell"])
    assert cell != NO_INDEX


def test_full_map(device):
    """With four times as many keys as entries, some queries get NO_INDEX: their search finds only other keys."""
    cells, steps = 1024, 3
    queries, cell = make_queries(4 * cells, 20_000)
    with MapFrame(device, cells, queries, world_cache_search_steps=steps) as frame:
        answers, checksums = frame.run()["answers"], frame["checksums"]
    lost = answers["cell"] == NO_INDEX
    assert np.count_nonzero(checksums) <= cells
    np.testing.assert_array_equal(checksums[answers["cell"][~lost]], answers["checksum"][~lost])
    assert ((answers["cell"] - answers["first"])[~lost] % cells).max() < steps
    tried = checksums[(answers["first"][lost, None] + np.arange(steps)) % cells]
    assert lost.any()
    assert (tried != 0).all()
    assert (tried != answers["checksum"][lost, None]).all()
    for number in np.unique(cell):
        assert len(set(answers["cell"][cell == number])) == 1, "queries of one cell found different entries"


def test_holes(device):
    """A cell is still found after the cells in earlier entries of its search died."""
    queries, _ = make_queries(800, 800)
    with MapFrame(device, 1024, queries, world_cache_search_steps=64) as frame:
        before = frame.run()["answers"]["cell"]
        away = (before - expected_keys(queries)[0]) % 1024 > 0
        assert away.any()
        life = np.zeros(1024, np.uint32)
        life[before[away]] = 5
        frame.upload(life=life)  # all others die
        queries["rng"][~away] = 0
        frame.ask(queries)
        again = frame.run()["answers"]["cell"]
    np.testing.assert_array_equal(again[away], before[away])


def test_points(device):
    """Each cell's point is that of one of its queries, and the order of queries doesn't decide which."""
    queries, cell = make_queries(300, 20_000)
    surfaces = []
    for order in (np.arange(len(queries)), np.random.default_rng(3).permutation(len(queries))):
        with MapFrame(device, 1024, queries[order], world_cache_search_steps=64) as frame:
            answers = frame.run().run()["answers"]
        surfaces.append(answers[np.argsort(order)])
    for name in ("position", "normal", "offset"):
        np.testing.assert_array_equal(surfaces[0][name], surfaces[1][name])
    apart = np.abs(surfaces[0]["position"] - queries["position"])
    step = 2 * queries["cell_size"] / 255
    is_mine = (apart <= 0.505 * step[:, None]).all(axis=1)
    chosen = np.unique(cell[is_mine])
    assert len(chosen) == 300, "a cell's point is none of its queries'"
    np.testing.assert_allclose(surfaces[0]["normal"], queries["normal"], atol=1e-3)
    height = np.sum((surfaces[0]["position"] - queries["position"]) * queries["normal"], axis=1)[is_mine]
    assert (np.abs(height) <= surfaces[0]["offset"][is_mine]).all(), "the offset does not cover the rounding"
    within = (surfaces[0]["position"] / queries["cell_size"][:, None] % 1)[np.unique(cell, return_index=True)[1]]
    np.testing.assert_allclose(within.mean(axis=0), 0.5, atol=4 * np.sqrt(1 / 12 / 300))


# ---- compaction -------------------------------------------------------------------------------------


def test_compaction(device):
    random = np.random.default_rng(1)
    for cells in (1024, 2048, 1 << 17):
        patterns = [[], [0], [cells - 1], [15, 16], [1023], range(1000, cells), range(cells)]
        patterns += [range(count) for count in (63, 64, 65)]
        patterns += [np.flatnonzero(random.random(cells) < density) for density in (0.01, 0.5)]
        with MapFrame(device, cells) as frame:
            for active in patterns:
                active = np.array(active, np.uint32)
                checksums, life = np.zeros((2, cells), np.uint32)
                checksums[active], life[active] = random.integers(1, 2**32, len(active)), 7
                frame.upload(checksums=checksums, life=life)
                frame.run()
                assert frame["counters"]["active_cells"] == len(active)
                np.testing.assert_array_equal(np.sort(frame["active_cells"][: len(active)]), active)
                groups = -(-len(active) // 64)
                assert frame["dispatch"]["size"]["group_count"].tolist() == [min(groups, 1024), -(-groups // 1024), 1]
                np.testing.assert_array_equal(frame["life"], life - (life > 0))


def test_lives(device):
    """Without history the map is empty; a cell exists for as many frames as its life."""
    queries, _ = make_queries(100, 400)
    queries["life"] = 3
    with MapFrame(device, 1024, queries, world_cache_search_steps=64) as frame:

        def active():
            return int(frame.run()["counters"]["active_cells"])

        assert active() == 0
        queries["rng"] = 0
        frame.ask(queries)
        assert [active() for _ in range(5)] == [100, 100, 100, 0, 0]
        frame.fill()
        assert active() == 1024
        frame.uniforms["this_frame.has_history"] = 0
        assert active() == 0
        for name in ("checksums", "life", "irradiance", "luminance_deltas"):
            assert not frame[name].any()


def test_only_cells_that_were_asked_for_are_updated(device):
    """With world_cache_updates=asked, the cells of the previous frame's queries; the others live on, and are updated
    again once they are asked for."""
    queries, cell = make_queries(100, 400)
    queries["life"] = 9
    every, some = queries["rng"].copy(), cell < 40
    asked = np.where(some, every, 0)
    with MapFrame(device, 1024, queries, world_cache_search_steps=64, world_cache_updates="asked") as frame:
        entries = frame.run()["answers"]["cell"]
        for queries["rng"], expected in (
            (asked, entries),
            (asked, entries[some]),
            (every, entries[some]),
            (0, entries),
            (0, []),
        ):
            frame.ask(queries)
            count = int(frame.run()["counters"]["active_cells"])
            np.testing.assert_array_equal(np.sort(frame["active_cells"][:count]), np.unique(expected))
            assert np.count_nonzero(frame["checksums"]) == 100


# ---- blend ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("exponent", "cap", "of_pixels"),
    [(1 / 8, 1 << 20, 1e9), (10.0, 1 << 20, 1e9), (1 / 8, 700, 1e9), (1 / 8, 1 << 20, 12.5)],
)
def test_blend(device, exponent, cap, of_pixels):
    cells, random = 2048, np.random.default_rng(2)
    irradiance = random.lognormal(0, 2, (cells, 4)).astype(np.float32)
    irradiance[:, 3] = random.integers(0, 40, cells)
    irradiance[irradiance[:, 3] == 0] = 0
    deltas = (irradiance[:, 0] * random.normal(0, 0.3, cells)).astype(np.float32)
    samples = np.zeros(cells, [("irradiance", "f4", 3), ("life", "u4")])
    samples["irradiance"] = random.lognormal(0, 2, (cells, 3))
    settings = {
        "world_cache_change_exponent": exponent,
        "world_cache_update_cap": cap,
        "world_cache_updates_per_pixel": of_pixels,
    }
    with MapFrame(device, cells, **settings) as frame:
        frame.fill(irradiance=irradiance, luminance_deltas=deltas, samples=samples)
        frame.run()
        found, found_deltas = frame["irradiance"], frame["luminance_deltas"]
    weights = np.array((0.2126, 0.7152, 0.0722))
    old, new = irradiance[:, :3].astype(float), samples["irradiance"].astype(float)
    count = np.minimum(np.where(irradiance[:, 3] > 0, irradiance[:, 3] + 0.25, 1), 32)
    change = np.clip(np.abs(deltas) / np.maximum(old @ weights, 1e-30), 0, 1)
    max_count = 32 - 31 * change**exponent
    blended = old + (new - old) / np.minimum(count, max_count)[:, None]
    untouched = (found == irradiance).all(axis=1)
    updated = ~untouched
    np.testing.assert_array_equal(found[updated, 3], count[updated])
    np.testing.assert_allclose(found[updated, :3], blended[updated], rtol=2e-4)  # the precision of pow
    moved = deltas + ((blended - old) @ weights - deltas) / 8
    np.testing.assert_allclose(found_deltas[updated], moved[updated], rtol=1e-3, atol=1e-4)
    share = updated.mean()
    expected = min(cap / cells, of_pixels * SIZE[0] * SIZE[1] / cells, 1)
    assert abs(share - expected) <= 4 * np.sqrt(expected * (1 - expected) / cells), share


@pytest.mark.parametrize(("change", "relight"), [(0.2, True), (1.0, True), (0.8, False)])
def test_changed_light_is_forgotten(device, change, relight):
    """All cells lower their sample counts when a scene is edited, also those that aren't updated: the next sample then
    has at least the weight of the share that changed."""
    cells, random = 1024, np.random.default_rng(4)
    irradiance = np.full((cells, 4), 2.0, np.float32)
    irradiance[:, 3] = random.integers(1, 33, cells)
    samples = np.zeros(cells, [("irradiance", "f4", 3), ("life", "u4")])
    settings = {"world_cache_relight": relight, "world_cache_change_exponent": 10}
    expected = np.minimum(irradiance[:, 3], (1 - change) / change) if relight else irradiance[:, 3]
    for updates, weights in (("asked", 0.0), ("all", 1 / np.clip(expected + 0.25, 1, 32))):  # no cell was asked for
        with MapFrame(device, cells, **settings, world_cache_updates=updates) as frame:
            frame.fill(irradiance=irradiance, samples=samples)
            frame.uniforms["this_frame.expected_change"] = change
            found = frame.run()["irradiance"]
        np.testing.assert_allclose(found[:, 0], 2.0 * (1 - weights), rtol=1e-4, atol=1e-5)
        if updates == "asked":
            np.testing.assert_allclose(found[:, 3], expected, rtol=1e-4, atol=1e-6)
        else:
            assert (weights >= change - 1e-3).all() or not relight


def test_cells_near_a_changed_light_forget(device):
    """A light of 1 lumen that went out, far less than a 64th of all light: cells whose irradiance it could have been
    have no value until they are sampled anew. Distant and bright ones are kept, and all in later frames."""
    cells = 1024
    kinds = np.array([(0.5, 0.1), (4.0, 0.1), (4.0, 1.0), (0.5, 30.0)])
    distances, brightness = np.tile(kinds, (cells // 4, 1)).T
    irradiance = np.repeat(brightness[:, None], 4, axis=1).astype(np.float32)
    irradiance[:, 3] = 16.0
    bounds = np.zeros((cells, 4), np.float32)
    bounds[:, 0], bounds[:, 3] = distances, 0.01
    may_be = 8 / np.pi / (distances**2 * brightness) > 0.5
    assert may_be[:4].tolist() == [True, True, False, False]
    changed = np.zeros(8, [("place", "f4", 3), ("power", "f4"), ("recent", "f4")])
    for recent in (1.0, 0.9):
        changed[0] = (0.005, 0.005, 0.005), 1.0, recent
        with MapFrame(device, cells, world_cache_updates="asked") as frame:
            frame.fill(irradiance=irradiance, bounds=bounds)
            frame.uniforms["this_frame.exposure"] = 1.0
            frame.uniforms["changed_lights.count"] = 1
            frame.uniforms["changed_lights.at"] = changed
            found = frame.run()["irradiance"]
        np.testing.assert_array_equal(found[:, 3], np.where(may_be & (recent == 1), 0, 16))


MAP, DECAY = "passes/world_cache/map.glsl", "passes/world_cache/decay.comp"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "map: the normal isn't in the key": (
            test_map,
            Bug(MAP, "make_world_cache_key", "return correct(world_position, vec3(0.0), cell_size);"),
        ),
        "full map: cells are shared": (
            test_full_map,
            Bug(
                MAP,
                "insert_world_cache_cell",
                "uint cell = correct(key, is_new); return cell == NO_INDEX ? world_cache_entry(key, 0u) : cell;",
            ),
        ),
        "holes: the search ends at one": (
            test_holes,
            Bug(
                MAP,
                "find_world_cache_cell",
                "uint cell = correct(key, empty_step); "
                "return empty_step < world_cache_settings.search_steps ? NO_INDEX : cell;",
            ),
        ),
        "points: half the offset": (
            test_points,
            Bug(
                MAP,
                "unpack_point",
                "WorldCacheSurface surface = correct(cell, point); surface.ray_offset *= 0.5; return surface;",
            ),
        ),
        "compaction: the first block begins a cell late": (
            test_compaction,
            Bug(
                "passes/world_cache/scan.comp",
                "main",
                "correct(); if (gl_LocalInvocationIndex == 0u) { world_cache_blocks.at[0] += 1u; }",
            ),
        ),
        "lives: dead cells keep what they hold": (test_lives, Bug(DECAY, "clear_cell", "")),
        "asked: all are updated": (
            test_only_cells_that_were_asked_for_are_updated,
            Bug(
                MAP,
                "is_to_update",
                "return world_cache_checksums.at[cell] != EMPTY_CELL "
                "&& world_cache_first_points.at[cell] != DIVIDED_CELL;",
            ),
        ),
        "blend: a sample too many": (
            lambda device: test_blend(device, 1 / 8, 1 << 20, 1e9),
            Bug("passes/world_cache/blend.comp", "SHORT_HISTORY_GROWTH", "1.0"),
        ),
        "cap: by half": (
            lambda device: test_blend(device, 1 / 8, 700, 1e9),
            Bug(
                "passes/world_cache/update.glsl",
                "find_cell_to_update",
                "uint cell = correct(place); return (place & 1u) == 0u ? cell : NO_INDEX;",
            ),
        ),
        "relight: forgotten": (
            lambda device: test_changed_light_is_forgotten(device, 0.2, True),
            Bug(DECAY, "relight", ""),
        ),
        "relight: frame after frame": (
            test_cells_near_a_changed_light_forget,
            Bug("passes/light_change.glsl", "light_change", "return correct(world_position, irradiance, ANY_CHANGE);"),
        ),
    },
    quick=("map: the normal isn't in the key",),
)

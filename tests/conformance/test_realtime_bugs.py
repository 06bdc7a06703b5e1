"""The groups of the realtime passes can fail: a seeded bug for each rule."""

from __future__ import annotations

import pytest
from seeded_bugs import expect_red, failing, rules_of

from solari_vk.conformance import (
    direct_checks,
    display_checks,
    frame_checks,
    gbuffer_checks,
    guide_checks,
    indirect_checks,
    light_tile_checks,
    specular_checks,
    world_cache_checks,
)
from solari_vk.conformance.realtime import Effort
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.gpu.shaders.patches import patched_shaders

DI_INITIAL, DI = "passes/restir_di/initial_and_temporal.glsl", "passes/restir_di/spatial_and_shade.comp"
GI_INITIAL, GI_TEMPORAL = "passes/restir_gi/initial.comp", "passes/restir_gi/temporal.comp"
RASTER, RESOLVE, PIXEL = (f"passes/gbuffer/{name}" for name in ("raster.vert", "resolve.comp", "pixel.glsl"))
SPECULAR, LOBE = "passes/specular_gi/trace.comp", "passes/specular_gi/lobe.glsl"
GI_SHADE = "passes/restir_gi/spatial_and_shade.comp"
CULL, GATHER = "passes/gbuffer/cull.comp", "passes/world_cache/sample.comp"
QUERY, DIVISION = "passes/world_cache/query.glsl", "passes/world_cache/division.glsl"
GENERATE, TILES = "passes/light_tiles/generate.comp", "passes/light_tiles/light_tiles.glsl"
TONEMAP, COMPOSE = "passes/display/tonemap.glsl", "passes/paths/compose.comp"
VIEW, VIEWS = "passes/display/debug_view.glsl", "passes/display/debug_views.glsl"
MIRRORS, WRITE = "passes/guides/mirrors.glsl", "passes/guides/write.comp"


def measure_zoo(device):
    return gbuffer_checks.measure_raster(device, gbuffer_checks.make_scene("material_zoo"))


def measure_one_mirror(device):
    return guide_checks.measure_mirrors(device, "one mirror")


def measure_two_mirrors(device):
    return guide_checks.measure_mirrors(device, "two mirrors")


def measure_indirect(device):
    """With less effort than the suite takes: the bugs are larger than this bar."""
    return indirect_checks.measure_indirect(device, (Effort(), 0.06))


def measure_termination(device):
    return specular_checks.measure_termination(device, "spread")


def measure_solaris_termination(device):
    return specular_checks.measure_termination(device, "camera_spread")


def measure_matte_box(device):
    return frame_checks.measure_closed_box(device, "matte")


def measure_contribution(device):
    with ShaderRunner(device) as shaders:
        yield from light_tile_checks.measure_contribution(device, shaders)


DARK_CORNER = (
    COMPOSE, "    sample_radiance.at[index] = emitted", "    if (all(lessThan(4u * pixel, camera.size))) { "
    "diffuse *= 0.5; }\n    diffuse_radiance.at[index] = diffuse;\n    sample_radiance.at[index] = emitted",
)  # fmt: skip
BUGS = {
    "raster with gaps": (measure_zoo, ["inside triangles"], RESOLVE, "imageLoad(depth, ivec2(at)).x == 0.0",
                         "(at.x & 7u) == 0u"),
    "jitter the wrong way": (measure_zoo, ["inside triangles", "at edges"], RASTER, "+ jitter * view.z",
                             "- jitter * view.z"),
    "mirrored instances inside out": (measure_zoo, ["at edges"], RASTER, "if (mirrored &&", "if (false &&"),
    "barycentrics swapped": (measure_zoo, ["inside triangles"],
                             "passes/gbuffer/raster.glsl", "ray.direction), row, triangle, barycentrics,",
                             "ray.direction), row, triangle, barycentrics.yx,"),
    "double-sided like single-sided": (measure_zoo, ["inside triangles", "at edges"], CULL,
                                       "& MATERIAL_DOUBLE_SIDED) != 0u", "& 0u) != 0u"),
    "motion without the camera's": (gbuffer_checks.measure_motion, ["motion vectors"], "passes/gbuffer/gbuffer.glsl",
                                    "project_to_uv(previous_world_position, previous_camera)",
                                    "project_to_uv(previous_world_position, camera)"),
    "motion without the instances'": (gbuffer_checks.measure_motion, ["motion vectors"], "passes/gbuffer/gbuffer.glsl",
                                      "|| rests(hit.instance))", "|| true)"),
    "rounding moves what rests": (lambda device: gbuffer_checks.measure_still(device, "traced"), ["what rests"],
                                  "passes/gbuffer/gbuffer.glsl", "&& camera_rests()) { return vec2(0.0); }",
                                  ") { return vec2(1e-7); }"),
    "motion the wrong way": (gbuffer_checks.measure_motion, ["motion vectors"], PIXEL, "motion_vector(now, before)",
                             "motion_vector(before, now)"),
    "the sky is near": (gbuffer_checks.measure_motion, ["motion vectors"], PIXEL,
                        "previous_camera.world_from_view[3] + ray.direction * 1e6",
                        "camera.world_from_view[3] + ray.direction"),
    "frustum without slack": (gbuffer_checks.measure_culling, ["culling drops"], CULL,
                              "(1.0 + 4.0 / vec2(camera.size))", "0.95"),
    "boxes' far side for their near one": (gbuffer_checks.measure_culling, ["culling drops"], CULL,
                                           "min(nearest, view_depth)", "view_depth"),
    "rays' mesh drawn for its bounds": (gbuffer_checks.measure_culling, ["culling drops"], CULL,
                                        "mesh.bounds_max - mesh.bounds_min);\n", "mesh.bounds_min);\n"),
    "extents with the wrong signs": (gbuffer_checks.measure_culling, ["culling drops"], CULL,
                                     "abs(normal * box.half_axes)", "normal * box.half_axes"),
    "pyramid of the nearest": (gbuffer_checks.measure_culling, ["culling drops"], "passes/gbuffer/depth_pyramid.comp",
                               "farthest = min(farthest, below", "farthest = max(farthest, below"),
    "pyramid off by a level": (gbuffer_checks.measure_culling, ["culling drops"], CULL,
                               "pyramid_index(level, uvec2(x, y))",
                               "pyramid_index(max(level, 2u) - 1u, uvec2(x, y))"),
    "second pass takes the previous frame's word": (gbuffer_checks.measure_culling, ["culling drops"], CULL,
                                                    "draws = visible && !was_visible", "draws = false"),
    "all is drawn twice": (gbuffer_checks.measure_culling, ["counted once"], CULL, "draws = visible && !was_visible",
                           "draws = visible"),
    "nothing is hidden": (gbuffer_checks.measure_culling, ["culling drops"], CULL,
                          "depth_value < farthest", "depth_value * 1e9 < farthest"),
    "lights twice as likely": (direct_checks.measure_direct, ["of a Cornell box", "all of the lamp"], DI,
                               "light.inverse_pdf * light_sample", "light.inverse_pdf * 0.5 * light_sample"),
    "1/M dropped": (direct_checks.measure_direct, ["of a Cornell box", "all of the lamp", "4 x 4 tiles"], DI_INITIAL,
                    " / float(restir_di_settings.candidates)", ""),
    "pdf of the light's point dropped": (direct_checks.measure_direct, ["of a Cornell box", "all of the lamp"], DI,
                                         "light.inverse_pdf * light_sample", "light_sample"),
    "visibility kept for the next frame": (
        direct_checks.measure_direct, ["of a Cornell box", "part of the lamp"], DI,
        "    di_reservoirs.at[index] = reservoir;",
        "    if (reservoir.unbiased_contribution_weight > 0.0 && transmittance(surface, resolve_light_sample("
        "reservoir.light_sample)) == vec3(0.0)) { reservoir.unbiased_contribution_weight = 0.0; }\n"
        "    di_reservoirs.at[index] = reservoir;",
    ),
    "no shadows": (direct_checks.measure_direct, ["part of the lamp", "nothing of the lamp"], DI,
                   "= transmittance(surface, resolved);", "= vec3(1.0);"),
    "lights not translated": (direct_checks.measure_changes, ["removing lights"], DI_INITIAL,
                              "= light_translation.at[reservoir.light_sample.light_index];",
                              "= reservoir.light_sample.light_index;"),
    "new lights taken for old": (direct_checks.measure_changes, ["removing lights"], "passes/restir_di/target.glsl",
                                 "light_index == NO_INDEX || previous_light.at[light_index] == NO_INDEX",
                                 "light_index == NO_INDEX"),
    "sums that begin a block late": (world_cache_checks.measure_world_cache, ["list of active cells"],
                                     "passes/world_cache/scan.comp", "uint before = sums[thread] - sum;",
                                     "uint before = sums[thread];"),
    "searches end at a hole": (world_cache_checks.measure_world_cache, ["every key"], "passes/world_cache/map.glsl",
                               "if (checksum == key.checksum) { return cell; }",
                               "if (checksum == key.checksum && i == 0u) { return cell; }"),
    "cells live forever": (world_cache_checks.measure_world_cache, ["cells die"], "passes/world_cache/decay.comp",
                           "= life - 1u;", "= life;"),
    "light gathered without pi": (world_cache_checks.measure_fixed_point, ["all bounces"], GATHER, "PI * path_light",
                                  "path_light"),
    "walls that hide nothing": (world_cache_checks.measure_leak, ["thin wall"], DIVISION,
                                "geometric_world_normal - eye, 1.0);", "geometric_world_normal - eye, 1e-3);"),
    "rays of the previous frame's surfaces meet them": (measure_indirect, ["one bounce"], GI_TEMPORAL,
                                                        "neighbor_surface.ray_offset = surface.ray_offset;", ""),
    "density of another distribution": (measure_indirect, ["one bounce", "no tile of 4 x 4"], GI_INITIAL,
                                        "? 2.0 * PI :", "? PI / 0.6 :"),
    "radiance where irradiance is": (measure_indirect, ["one bounce"], QUERY, "(INVERSE_PI * albedo)", "albedo"),
    "contribution weight forgotten": (measure_indirect, ["no tile of 4 x 4"], GI_SHADE,
                                      "* reservoir.unbiased_contribution_weight", ""),
    "own sample merged twice": (measure_indirect, ["one bounce"], GI_SHADE,
                                "other = gi_temporal_reservoirs.at[neighbor_index]", "other = reservoir"),
    "a hemisphere too few": (measure_indirect, ["one bounce"], GI_INITIAL, "? 2.0 * PI :", "? PI :"),
    "no Fresnel in mirrors": (specular_checks.measure_mirror, ["a mirror"], LOBE,
                              "specular_fresnel(brdf, wo.z), INFINITY", "vec3(1.0), INFINITY"),
    "lights counted twice": (specular_checks.measure_gallery, ["four metals"], SPECULAR,
                             "* power_heuristic(path.bounce_pdf, light_pdf)", ""),
    "sun counted twice": (specular_checks.measure_gallery, ["four metals"], "scene/sampling.glsl",
                          "* power_heuristic(bounce_pdf, light_pdf)", ""),
    "light samples without weights": (specular_checks.measure_gallery, ["four metals"], SPECULAR,
                                      "* power_heuristic(light.solid_angle_pdf, brdf_pdf(brdf, wo, wi))", ""),
    "no Fresnel in mirrors of a gallery": (specular_checks.measure_gallery, ["each metal"], LOBE,
                                           "specular_fresnel(brdf, wo.z), INFINITY", "vec3(1.0), INFINITY"),
    "no light samples": (specular_checks.measure_gallery, ["four metals"], SPECULAR,
                         "if (!brdf.mirror || brdf.specular_probability < 1.0) {", "if (false) {"),
    "roulette's survivors are not raised": (specular_checks.measure_gallery, ["four metals"], SPECULAR,
                                            "path.throughput /= survival;", ""),
    "no first lights": (specular_checks.measure_gallery, ["four metals"], SPECULAR,
                        "_settings.di_roughness ? INFINITY : 0.0", "_settings.di_roughness ? 0.0 : 0.0"),
    "pdf of another lobe": (specular_checks.measure_gallery, ["each metal"], LOBE, "float pdf = specular_pdf(",
                            "float pdf = 1.1 * specular_pdf("),
    "paths never end early": (measure_termination, ["wider than a cell ends in"], SPECULAR,
                              "return spread_width > cell_size &&", "return false &&"),
    "paths end at once": (measure_termination, ["narrower than a cell"], SPECULAR,
                          "return spread_width > cell_size &&", "return"),
    "every cone begins at the camera": (measure_termination, ["narrower than a cell"], SPECULAR,
                                        "if (specular_gi_settings.termination == SPECULAR_TERMINATION_CAMERA_SPREAD) {",
                                        "if (true) {"),
    "the camera's cone has no width": (measure_solaris_termination, ["cone from the camera"], SPECULAR,
                                       "widen_as_solari(0.0, distance,", "widen_as_solari(0.0, 0.0,"),
    "cells are not crossed diagonally": (measure_solaris_termination, ["sqrt(3) cells"], SPECULAR,
                                         "(as_solari ? sqrt(3.0) : 1.0)", "1.0"),
    "hit surfaces don't widen the cone": (measure_solaris_termination, ["matte wall has widened"], SPECULAR,
                                          "if (as_solari) { path.spread_width =", "if (false) { path.spread_width ="),
    "light for nothing": (measure_matte_box, ["matte walls is as bright"],
                          COMPOSE, "    sample_radiance.at[index] = emitted + diffuse",
                          "    sample_radiance.at[index] = emitted + 1.08 * diffuse"),
    "a dark corner": (frame_checks.measure_light, ["each of 4 x 4 tiles"], *DARK_CORNER),
    "a dark corner of a closed box": (measure_matte_box, ["4 x 4 tiles of a closed box"], *DARK_CORNER),
    "light that stays": (frame_checks.measure_light, ["as bright", "little light is left", "almost no light"], COMPOSE,
                         "diffuse_radiance.at[index] = diffuse;",
                         "diffuse_radiance.at[index] = diffuse = max(diffuse, vec3(0.03));"),
    "divided by nothing": (frame_checks.measure_finite, ["finite"], COMPOSE,
                           "    sample_radiance.at[index] = emitted",
                           "    sample_radiance.at[index] = uintBitsToFloat(0x7FC00000u) + emitted"),
    "tiles packed without exposure": (light_tile_checks.measure_tiles, ["within half a step", "a sun of 100,000 lux"],
                                      TILES, "(resolved.radiance, this_frame.exposure)", "(resolved.radiance, 1.0)"),
    "directions packed as places": (light_tile_checks.measure_tiles, ["light's kind"], TILES,
                                    "        resolved.kind,\n", "        0u,\n"),
    "every tile alike": (light_tile_checks.measure_tiles, ["lights are", "no sample twice", "uncorrelated"], GENERATE,
                         "uvec2(index / samples_each,", "uvec2(0u,"),
    "every frame alike": (light_tile_checks.measure_tiles, ["no sample twice", "uncorrelated"], GENERATE,
                          "this_frame.index, this_frame.seed", "0u, this_frame.seed"),
    "seeds summed": (light_tile_checks.measure_tiles, ["no sample twice"], GENERATE, "uint rng = seed_rng(",
                     "uint rng = index + 1024u * this_frame.index; seed_rng("),
    "light bled into black": (light_tile_checks.measure_tiles, ["color channel of 0"], TILES,
                              "pack_radiance_log2_rgb9e5(resolved.radiance,",
                              "pack_radiance_log2_rgb9e5(resolved.radiance + 0.02 * max_component(resolved.radiance),"),
    "twice the light packed": (measure_contribution, ["lights a floor"], "common/packing.glsl",
                               "log2(radiance * exposure + 1.0)", "log2(2.0 * radiance * exposure + 1.0)"),
    "logarithms taken for light": (light_tile_checks.measure_noise, ["no noisier"], "common/packing.glsl",
                                   "(exp2(unpack_rgb9e5(bits)) - 1.0)", "unpack_rgb9e5(bits)"),
    "mirrors describe themselves": (measure_one_mirror, ["diffuse albedos", "specular albedos", "virtual normals"],
                                    WRITE, "frame_settings.primary_surface_replacement != 0u",
                                    "frame_settings.primary_surface_replacement > 1u"),
    "normals as they are": (measure_one_mirror, ["virtual normals"], WRITE, "mat3(chain) * surface.world_normal",
                            "surface.world_normal"),
    "lengths as depths": (measure_one_mirror, ["virtual depths"], WRITE, "path_length * camera_ray.depth_per_t",
                          "path_length"),
    "mirrors that stand still": (measure_one_mirror, ["motion"], MIRRORS, "previous.id != instance.id", "true"),
    "hits don't move": (measure_one_mirror, ["motion"], MIRRORS, "interpolate_position(mesh.positions, mesh, hit)",
                        "0.0 * world_position"),
    "normals don't turn": (measure_one_mirror, ["motion"], MIRRORS, "cofactors * object_normal", "mirror.normal"),
    "planes through the origin": (measure_one_mirror, ["motion"], MIRRORS, "mat3(chain) * moved + chain[3]",
                                  "chain[3]"),
    "no reflection in the motion": (measure_one_mirror, ["motion"], WRITE,
                                    "previous_chain * vec4(previous_position, 1.0)", "previous_position"),
    "reflections in wrong order": (measure_two_mirrors, ["two mirrors: virtual normals", "specular motion"], MIRRORS,
                                   "mat3(chain) * householder", "householder * mat3(chain)"),
    "metal that is painted": (measure_one_mirror, ["metals have"], WRITE, "base_color * (1.0 - material.metallic)",
                              "base_color"),
    "albedos squared": (measure_one_mirror, ["diffuse albedo of a dielectric"], WRITE, "guides.diffuse_albedo =",
                        "guides.diffuse_albedo = material.base_color *"),
    "metal without second bounces": (measure_one_mirror, ["white metal"], "scene/prepared_brdf.glsl",
                                     "specular_albedo(material.base_color, ab)", "material.base_color * ab.x + ab.y"),
    "glass that describes itself": (guide_checks.measure_wall, ["through a clear wall: diffuse albedos", "depths"],
                                    WRITE, "return is_glass(material) &&", "return false &&"),
    "lamps behind glass without noise": (guide_checks.measure_wall, ["before a lamp"], WRITE,
                                         "shown.lit || !is_wall", "true"),
    "normals of any length": (guide_checks.measure_range, ["extreme scenes give finite guides"], WRITE,
                              "vec4(guides.world_normal, guides", "vec4(1.1 * guides.world_normal, guides"),
    "light counted twice": (guide_checks.measure_parts, ["add up"], COMPOSE,
                            "    sample_radiance.at[index] = emitted + diffuse",
                            "    sample_radiance.at[index] = emitted + 2.0 * diffuse"),
    "emission after exposure": (guide_checks.measure_parts, ["emission is"], COMPOSE,
                                "emission.at[index] = emitted;", "emission.at[index] = emitted * this_frame.exposure;"),
    "a stop too bright": (display_checks.measure_picture, ["white is", "sRGB", "Reinhard", "ACES", "AgX"], TONEMAP,
                          "tonemap(radiance * this_frame.exposure)", "tonemap(2.0 * radiance * this_frame.exposure)"),
    "gamma for sRGB": (display_checks.measure_picture, ["sRGB"], TONEMAP, "SRGB_SLOPE * linear, lessThanEqual",
                       "pow(linear, vec3(1.0 / 2.2)), lessThanEqual"),
    "Reinhard by channel": (display_checks.measure_picture, ["Reinhard"], TONEMAP, "1.0 + luminance(color)",
                            "1.0 + color"),
    "ACES without its exposure": (display_checks.measure_picture, ["ACES"], TONEMAP, "ACES_EXPOSURE * color", "color"),
    "AgX without its outset": (display_checks.measure_picture, ["AgX"], TONEMAP, "shaped * inverse(AGX_INSET)",
                              "shaped"),
    "a view of one color": (display_checks.measure_views, ["more than one color"], VIEW,
                             "display_settings.debug_view, pixel", "display_settings.debug_view, uvec2(0u)"),
    "another light shown": (display_checks.measure_views, ["views of light"], VIEW,
                            "(display_settings.debug_view,",
                            "(display_settings.debug_view == 2u ? 1u : display_settings.debug_view,"),
    "motion shown twice": (display_checks.measure_views, ["views of surfaces"], VIEWS, "/ 16.0, 0.5)", "/ 8.0, 0.5)"),
    "another yellow": (display_checks.measure_views, ["Viridis"], VIEWS, "vec3(0.993, 0.906, 0.144)",
                       "vec3(1.0, 1.0, 0.0)"),
    "a view of NaN": (display_checks.measure_views, ["more than one color"], VIEWS,
                      "show_share(fract(log2(camera.near",
                      "show_share(fract(uintBitsToFloat(0x7FC00000u) + log2(camera.near"),
}  # fmt: skip


QUICK = ("mirrored instances inside out", "boxes' far side for their near one", "motion the wrong way",
         "sums that begin a block late", "cells live forever", "light for nothing", "divided by nothing",
         "tiles packed without exposure", "every tile alike", "lengths as depths", "light counted twice",
         "paths never end early", "a stop too bright", "motion shown twice")  # fmt: skip


# The rules that fail in test_seeds_without_effect_are_noticed.
OF_SEEDS = ("same bits", "another seed")
MODULES = (gbuffer_checks, direct_checks, world_cache_checks, indirect_checks, specular_checks, frame_checks)


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__.split(".")[-1])
def test_every_rule_has_a_bug(module):
    """Each Rule that is a constant of its module has a seeded bug that makes it fail."""
    parts = [part for _, parts, *_ in BUGS.values() for part in parts] + list(OF_SEEDS)
    rules = rules_of(module)
    assert rules
    assert not [name for name in rules if not any(part in name for part in parts)]


# The other bugs are slow, because they need many frames or new pipelines with ray queries.
@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK else [pytest.mark.slow]) for n in BUGS])
def test_bug_is_noticed(device, name):
    measure, parts, *bug = BUGS[name]
    with patched_shaders(tuple(bug)):
        expect_red(measure(device), *parts)


@pytest.mark.slow  # six renderers
def test_seeds_without_effect_are_noticed(device, monkeypatch):
    take = frame_checks._take
    monkeypatch.setattr(frame_checks, "_take", lambda device, seed: take(device, 0))
    expect_red(frame_checks.measure_determinism(device), OF_SEEDS[1])
    seeds = iter(range(3))
    monkeypatch.setattr(frame_checks, "_take", lambda device, seed: take(device, next(seeds)))
    expect_red(frame_checks.measure_determinism(device), OF_SEEDS[0])


def test_brief_check_of_indirect_light_holds_without_a_bug(device):
    """The control of the bugs that `measure_indirect` notices."""
    assert not failing(measure_indirect(device))

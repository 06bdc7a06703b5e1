"""The material model in float64 NumPy, with albedos by quadrature.

Directions are unit vectors (..., 3) in a frame whose z is the normal. Terms: GGX (Walter et al. 2007),
height-correlated Smith (Heitz 2014), Schlick (1994), the multi-scattering factor 1 + F0 (1 / Ess - 1)
(Turquin 2019; Kulla and Conty 2017), diffuse under the layer in the reciprocal form
(1 - E(wo)) (1 - E(wi)) / (1 - Eavg) (Kelemen and Szirmay-Kalos 2001).
"""

from functools import lru_cache

import numpy as np

MIRROR_ALPHA = 0.001


def alpha_of(perceptual_roughness):
    return perceptual_roughness**2


def ggx(cos_h, alpha):
    """Density of microfacet normals per solid angle."""
    # sin^2 + alpha^2 cos^2 has no cancellation near the normal, unlike cos^2 (alpha^2 - 1) + 1.
    return alpha**2 / (np.pi * ((1 - cos_h) * (1 + cos_h) + (alpha * cos_h) ** 2) ** 2)


def smith_lambda(cos, alpha):
    tangent_squared = (1 - cos) * (1 + cos) / cos**2
    return (np.sqrt(1 + alpha**2 * tangent_squared) - 1) / 2


def smith_g1(cos, alpha):
    return 1 / (1 + smith_lambda(cos, alpha))


def smith_g2(cos_o, cos_i, alpha):
    return 1 / (1 + smith_lambda(cos_o, alpha) + smith_lambda(cos_i, alpha))


def schlick_weight(cos):
    return (1 - np.clip(cos, 0, 1)) ** 5


def half_vector(wo, wi):
    half = wo + wi
    return half / np.linalg.norm(half, axis=-1, keepdims=True)


def single_scattering(wo, wi, f0, alpha):
    """GGX reflection without the cosine, f0 (..., 3) or a number: (..., 1 or 3)."""
    half = half_vector(wo, wi)
    cos_o, cos_i = wo[..., 2], wi[..., 2]
    cos_d = np.einsum("...i,...i->...", *np.broadcast_arrays(wo, half))
    above = (cos_o > 0) & (cos_i > 0)
    safe_o, safe_i = np.where(above, cos_o, 1), np.where(above, cos_i, 1)
    shape = ggx(half[..., 2], alpha) * smith_g2(safe_o, safe_i, alpha) / (4 * safe_o * safe_i)
    fresnel = f0 + (1 - np.asarray(f0)) * schlick_weight(cos_d)[..., None]
    return np.where(above, shape, 0)[..., None] * fresnel


def visible_normals(wo, u, v, alpha):
    """Microfacet normals seen from wo (3,), for numbers u and v in [0, 1) (Heitz 2018)."""
    # Heitz 2018, "Sampling the GGX distribution of visible normals": the view is stretched to a hemisphere, whose
    # projected disk is sampled, and the normal is stretched back.
    stretched = np.array((alpha * wo[0], alpha * wo[1], wo[2]))
    stretched /= np.linalg.norm(stretched)
    across = np.array((-stretched[1], stretched[0], 0.0))
    length = np.linalg.norm(across)
    first = across / length if length > 1e-12 else np.array((1.0, 0.0, 0.0))
    second = np.cross(stretched, first)
    radius, angle = np.sqrt(u), 2 * np.pi * v
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    share = (1 + stretched[2]) / 2
    y = (1 - share) * np.sqrt(np.maximum(0, 1 - x**2)) + share * y
    z = np.sqrt(np.maximum(0, 1 - x**2 - y**2))
    normal = x[..., None] * first + y[..., None] * second + z[..., None] * stretched
    normal = normal * (alpha, alpha, 1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


@lru_cache(maxsize=4096)
def directional_albedo_terms(alpha, cos_o, resolution=256):
    """(A, B) with E(F0) = F0 A + B, single scattering, by quadrature over visible normals."""
    if alpha <= MIRROR_ALPHA:
        weight = float(schlick_weight(cos_o))
        return 1 - weight, weight
    nodes, weights = np.polynomial.legendre.leggauss(resolution)
    nodes, weights = (nodes + 1) / 2, weights / 2
    # u = sin^2(theta) makes the projected disk smooth, and nodes cluster at its rim, where the tails of low
    # roughness are. The integrand is periodic in the angle, where the midpoint rule is the best.
    theta, dtheta = np.pi / 2 * (1 - (1 - nodes) ** 3), np.pi / 2 * 3 * (1 - nodes) ** 2 * weights
    u, du = np.sin(theta) ** 2, 2 * np.sin(theta) * np.cos(theta) * dtheta
    v = (np.arange(resolution) + 0.5) / resolution
    wo = np.array((np.sqrt(1 - cos_o**2), 0.0, cos_o))
    normal = visible_normals(wo, *np.meshgrid(u, v, indexing="ij"), alpha)
    cos_d = normal @ wo
    cos_i = 2 * cos_d * normal[..., 2] - cos_o
    # Directions below the surface reflect nothing: their energy is what multiple scattering adds again.
    above = cos_i > 0
    safe_i = np.where(above, cos_i, 1)
    value = np.where(above, smith_g2(cos_o, safe_i, alpha) / smith_g1(cos_o, alpha), 0)
    weight = schlick_weight(cos_d)
    area = du[:, None] / resolution
    return float((value * (1 - weight) * area).sum()), float((value * weight * area).sum())


def multi_scattering(f0, single_albedo):
    """The factor for single scattering that adds the energy of multiple scattering."""
    return 1 + f0 * (1 / single_albedo - 1)


class Layer:
    """The specular layer of one roughness; interpolates its albedo at any angle from exact values."""

    def __init__(self, alpha, nodes=160, resolution=160):
        self.alpha = alpha
        # Nodes are denser at grazing angles, where the albedo changes fastest.
        self.cosines = np.linspace(0.01, 1, nodes) ** 2
        terms = np.array([directional_albedo_terms(alpha, float(c), resolution) for c in self.cosines])
        self.a, self.b = terms[:, 0], terms[:, 1]

    def terms(self, cos):
        position = np.sqrt(np.clip(cos, self.cosines[0], 1))
        roots = np.sqrt(self.cosines)
        return np.interp(position, roots, self.a), np.interp(position, roots, self.b)

    def albedo(self, cos, f0):
        """E (..., 3 or 1) with multiple scattering, for f0 (3,) or a number."""
        a, b = (t[..., None] for t in self.terms(np.asarray(cos)))
        return (f0 * a + b) * multi_scattering(f0, a + b)

    def average_albedo(self, f0):
        """The cosine-weighted average: 2 times the integral of E(mu) mu over mu in [0, 1]."""
        nodes, weights = np.polynomial.legendre.leggauss(128)
        mu, weights = (nodes + 1) / 2, weights / 2
        return 2 * (self.albedo(mu, f0) * (mu * weights)[:, None]).sum(axis=0)


class Surface:
    """The BRDF of one material, with both lobes."""

    def __init__(
        self,
        base_color=0.8,
        metallic=0.0,
        perceptual_roughness=0.5,
        reflectance=0.5,
        layering="conserving",
        resolution=160,
    ):
        self.base_color = np.broadcast_to(np.asarray(base_color, np.float64), (3,))
        self.metallic = float(metallic)
        self.alpha = alpha_of(perceptual_roughness)
        self.dielectric_f0 = 0.16 * np.broadcast_to(np.asarray(reflectance, np.float64), (3,)) ** 2
        self.layer = Layer(self.alpha, resolution=resolution)
        self.layering = layering

    def diffuse(self, wo, wi):
        f0, layer = self.dielectric_f0, self.layer
        if self.layering == "conserving":
            through = (1 - layer.albedo(wo[..., 2], f0)) * (1 - layer.albedo(wi[..., 2], f0))
            share = through / (1 - layer.average_albedo(f0))
        elif self.layering == "sum":
            share = 1.0
        else:
            share = np.prod([1 - (f0 + (1 - f0) * schlick_weight(w[..., 2])[..., None]) for w in (wo, wi)], axis=0)
        return share * self.base_color / np.pi

    def specular(self, wo, wi, f0):
        a, b = self.layer.terms(wo[..., 2])
        return single_scattering(wo, wi, f0, self.alpha) * multi_scattering(f0, (a + b)[..., None])

    def value(self, wo, wi):
        """f (..., 3) without the cosine; zero below the surface."""
        dielectric = self.diffuse(wo, wi) + self.specular(wo, wi, self.dielectric_f0)
        metal = self.specular(wo, wi, self.base_color)
        above = (wo[..., 2] > 0) & (wi[..., 2] > 0)
        return np.where(above[..., None], (1 - self.metallic) * dielectric + self.metallic * metal, 0)


def hemisphere_grid(rows, columns):
    """Midpoint directions (rows, columns, 3) over the upper hemisphere, and their solid angles."""
    edges = np.pi / 2 * np.arange(rows + 1) / rows
    solid = (np.cos(edges[:-1]) - np.cos(edges[1:])) * 2 * np.pi / columns
    phi = (np.arange(columns) + 0.5) * 2 * np.pi / columns
    theta, phi = np.meshgrid((edges[:-1] + edges[1:]) / 2, phi, indexing="ij")
    directions = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    return directions, np.broadcast_to(solid[:, None], theta.shape)

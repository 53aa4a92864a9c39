from __future__ import annotations  # Delayed parsing of type annotations

import drjit as dr
import mitsuba as mi
from genmf_mi.plugins.layers import Layers


def softplus_cosine(x: mi.Float, sharpness: mi.Float) -> mi.Float:
    """
    The smooth diffuse activation φ(x) = softplus(s·x) / softplus(s) of GenMF.

    It is 1 for x = 1, tends to max(x, 0) as s grows, and keeps a gradient in
    the shade, where the Lambertian cosine has none.
    """

    def softplus(y):
        # Stable for large |y|; `dr.maximum` would propagate NaN of inactive lanes
        return dr.fmax(y, 0) + dr.log(1 + dr.exp(-dr.abs(y)))

    return softplus(sharpness * x) / softplus(sharpness)


class TwoLight(mi.BSDF):
    r"""
    .. _bsdf-twolight:

    Two-light diffuse material (:monosp:`twolight`)
    -----------------------------------------------

    .. pluginparameters::

     * - albedo
       - |float| or |texture|
       - The grey albedo γ of the material. (Default: 0.8)
       - |exposed|, |differentiable|

     * - attribute
       - |string|
       - Name of a one-channel mesh attribute (e.g. ``vertex_albedo``) that
         multiplies the albedo; empty for a material of one colour.
         (Default: none)

     * - occlusion, emission
       - |string|
       - Names of one-channel mesh attributes: what arrives of the ambient
         light, and what the surface gives off, over what a white one of this
         material reflects in full light; empty for 1 and for 0.
         (Default: none)

     * - ambient
       - |float|
       - The ambient coefficient a in [0, 1). (Default: 0.2)
       - |exposed|, |differentiable|

     * - key, fill
       - |vector|
       - Directions *towards* the key light and the fill light. They need not
         be normalised. (Default: (-0.4, 0.5, 1) and (0.8, 0.1, 0.6))
       - |exposed|, |differentiable|

     * - key_weight, fill_weight
       - |float|
       - Weights of the two lights. (Default: 0.75 and 0.25)
       - |exposed|, |differentiable|

     * - sharpness
       - |float|
       - Sharpness s of the activation; the Lambertian cosine for s → ∞.
         (Default: 8)
       - |exposed|, |differentiable|

     * - layers
       - |bool|
       - Shade as a filament print does whose layers are too fine to see.
         (Default: false)

     * - build
       - |vector|
       - The direction in which the layers are stacked, in the world frame.
         (Default: (0, 1, 0))

     * - bulge
       - |float|
       - How far the side of a bead bulges, in layer heights; 0.5 is round.
         (Default: 0.5)

     * - lights
       - |string|
       - Frame of the two directions: ``camera`` (x right, y up, z towards the
         viewer: the lights travel with the camera) or ``world``.
         (Default: ``camera``)

    This material carries its own two directional lights, as GenMF does: its
    appearance is a function of the shading normal alone,

    .. math::

        G = \gamma \left( a + (1 - a) \left( w_k\, \phi(\mathbf{n} \cdot
        \mathbf{l}_k) + w_f\, \phi(\mathbf{n} \cdot \mathbf{l}_f) \right)
        \right), \qquad
        \phi(x) = \frac{\mathrm{softplus}(s x)}{\mathrm{softplus}(s)}.

    With an attribute o of ``occlusion`` and e of ``emission``, the ambient
    coefficient in the sum is a·o, and γ·e is added to G, up to γ in total, which
    is the brightest that a screen would show.

    With ``layers``, the normal is replaced by the mix of normals that a stack of
    beads along ``build`` shows in the direction of the viewer, and G is the mean
    over them (:py:class:`genmf_mi.plugins.layers.Layers`). It does not depend on
    the height of the layers as long as they are not resolved. Level walls look
    alike then, whatever their tilt: a tread or an overhang is all that relief
    shows there.

    The integrator :ref:`monochrome <integrator-monochrome>` reads G through
    :py:meth:`shading`. Under any other integrator, the material behaves as a
    diffuse reflector of albedo γ whose foreshortening is φ instead of the
    clamped cosine.

    .. tabs::

        .. code-tab:: xml

            <bsdf type="twolight">
                <float name="albedo" value="0.8"/>
                <float name="ambient" value="0.2"/>
                <vector name="key" value="-0.4, 0.5, 1"/>
                <vector name="fill" value="0.8, 0.1, 0.6"/>
            </bsdf>

        .. code-tab:: python

            'type': 'twolight',
            'albedo': 0.8,
            'ambient': 0.2,
            'key': [-0.4, 0.5, 1],
            'fill': [0.8, 0.1, 0.6]
    """

    def __init__(self, props):
        super().__init__(props)

        self.albedo = props.get_texture("albedo", 0.8)
        self.attribute = props.get("attribute", "")
        self.occlusion, self.emission = props.get("occlusion", ""), props.get("emission", "")
        self.ambient = mi.Float(props.get("ambient", 0.2))
        self.key = mi.Vector3f(props.get("key", [-0.4, 0.5, 1.0]))
        self.fill = mi.Vector3f(props.get("fill", [0.8, 0.1, 0.6]))
        self.key_weight = mi.Float(props.get("key_weight", 0.75))
        self.fill_weight = mi.Float(props.get("fill_weight", 0.25))
        self.sharpness = mi.Float(props.get("sharpness", 8.0))
        self.lights = props.get("lights", "camera")
        self.build = mi.Vector3f(props.get("build", [0.0, 1.0, 0.0]))
        bulge, self.layers = props.get("bulge", 0.5), None

        if self.lights not in ("camera", "world"):
            raise Exception(f'"lights" must be "camera" or "world", got "{self.lights}"')
        if not 0 <= props.get("ambient", 0.2) < 1:
            raise Exception('"ambient" must lie in [0, 1)')
        if props.get("sharpness", 8.0) <= 0:
            raise Exception('"sharpness" must be positive')
        if not 0 <= bulge <= 1:
            raise Exception('"bulge" must lie in [0, 1]')
        for name in ("key", "fill", "build"):
            if dr.all(getattr(self, name) == 0):
                raise Exception(f'"{name}" is a direction and cannot be zero')

        if props.get("layers", False):
            self.stack(bulge)

        # Rotation from the frame of the lights to the world: see `aim()`
        self.to_world = mi.Matrix3f(1)

        flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [flags]
        self.m_flags = flags

    def traverse(self, cb):
        cb.put("albedo", self.albedo, mi.ParamFlags.Differentiable)
        for name in ("ambient", "key", "fill", "key_weight", "fill_weight", "sharpness"):
            cb.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys):
        pass

    def stack(self, bulge: float | None):
        """Shade as a stack of beads from now on, whose sides bulge by so many layer heights; None: smooth."""
        self.layers = None if bulge is None else Layers(bulge)

    def aim(self, sensor: mi.Sensor):
        """
        Let lights given in the camera frame follow ``sensor``.

        Mitsuba's camera frame has x to the left and z along the view; the
        lights are given with x to the right and z towards the viewer.
        """
        if self.lights == "world":
            return
        m = sensor.world_transform().matrix
        self.to_world = mi.Matrix3f(
            -m[0, 0], m[0, 1], -m[0, 2], -m[1, 0], m[1, 1], -m[1, 2], -m[2, 0], m[2, 1], -m[2, 2]
        )
        # A literal would be baked into the kernel: one compilation per view
        dr.make_opaque(self.to_world)

    def reflectance(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Float:
        """The albedo γ, times the mesh attribute where there is one."""
        albedo = self.albedo.eval_1(si, active)
        if self.attribute:
            albedo *= si.shape.eval_attribute_1(self.attribute, si, active)
        return albedo

    def shading(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Float:
        """The grey value G of the two-light model."""
        n = si.sh_frame.n
        if self.layers:
            # Where the camera is does not depend on the surface
            view = dr.detach(si.to_world(si.wi))
            mix = self.layers.normals(dr.normalize(n), view, dr.normalize(self.build), active)
            diffuse = sum(weight * self.diffuse(normal) for weight, normal in mix)
        else:
            diffuse = self.diffuse(n)
        light = dr.lerp(diffuse, 1, self.ambient)
        if self.occlusion:
            light -= self.ambient * (1 - si.shape.eval_attribute_1(self.occlusion, si, active))
        G = self.reflectance(si, active) * light
        if self.emission:
            emission = si.shape.eval_attribute_1(self.emission, si, active)
            white = self.albedo.eval_1(si, active)
            G = dr.minimum(G + white * emission, white)
        return G

    def diffuse(self, n: mi.Vector3f) -> mi.Float:
        """What the two lights give to a surface of normal ``n``, without the albedo."""
        key = dr.dot(n, self.to_world @ dr.normalize(self.key))
        fill = dr.dot(n, self.to_world @ dr.normalize(self.fill))
        return self.key_weight * softplus_cosine(key, self.sharpness) + self.fill_weight * softplus_cosine(
            fill, self.sharpness
        )

    def eval_diffuse_reflectance(self, si, active=True):
        return mi.Spectrum(self.reflectance(si, active))

    def sample(self, ctx, si, sample1, sample2, active=True):
        cos_theta_i = mi.Frame3f.cos_theta(si.wi)
        active &= cos_theta_i > 0

        bs = mi.BSDFSample3f()
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        bs.pdf = mi.warp.square_to_cosine_hemisphere_pdf(bs.wo)
        bs.eta = 1.0
        bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        bs.sampled_component = 0

        value = self.eval(ctx, si, bs.wo, active) / bs.pdf
        return bs, value & (active & (bs.pdf > 0))

    def eval(self, ctx, si, wo, active=True):
        cos_theta_i, cos_theta_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active &= (cos_theta_i > 0) & (cos_theta_o > 0)
        value = self.reflectance(si, active) * dr.inv_pi * softplus_cosine(cos_theta_o, self.sharpness)
        return mi.Spectrum(value) & active

    def pdf(self, ctx, si, wo, active=True):
        cos_theta_i, cos_theta_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        pdf = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        return dr.select((cos_theta_i > 0) & (cos_theta_o > 0), pdf, 0)

    def eval_pdf(self, ctx, si, wo, active=True):
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def to_string(self):
        return (
            f'TwoLight[albedo = {self.albedo}, attribute = "{self.attribute}",'
            f' ambient = {self.ambient}, lights = "{self.lights}",'
            f" sharpness = {self.sharpness}]"
        )


mi.register_bsdf("twolight", TwoLight)

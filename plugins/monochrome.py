from __future__ import annotations  # Delayed parsing of type annotations

import drjit as dr
import mitsuba as mi
from mitsuba.python.ad.integrators.common import PSIntegrator

AOVS = ["depth", "normal.X", "normal.Y", "normal.Z", "coverage"]


class Monochrome(PSIntegrator):
    r"""
    .. _integrator-monochrome:

    One-colour appearance with geometry buffers (:monosp:`monochrome`)
    ------------------------------------------------------------------

    .. pluginparameters::

     * - aovs
       - |bool|
       - Append the channels ``depth``, ``normal.X``, ``normal.Y``,
         ``normal.Z`` and ``coverage`` to the image. (Default: true)

     * - silhouettes
       - |bool|
       - Also differentiate the motion of silhouettes, by projective sampling.
         The geometry buffers have no such derivative, so that this excludes
         ``aovs``. (Default: false)

    This integrator shoots one ray per sample and returns the grey value G that
    the material :ref:`twolight <bsdf-twolight>` gives at the first
    intersection: no light transport is simulated, because the material carries
    its own two lights. The background is 0.

    The geometry buffers follow the image in this order: planar depth along the
    optical axis in scene units, the shading normal in the world frame, and the
    coverage (the share of a pixel that the object fills). All are averages
    over the samples of a pixel with 0 outside of the object: divide depth and
    normal by the coverage where it is not zero.

    Everything is differentiable with respect to the geometry. The rays are
    fixed and the hit point moves with the surface, which gives the exact
    derivative wherever visibility does not change.

    The shape ``sdfgrid`` can be rendered, but derivatives with respect to its
    grid are refused: Mitsuba 3.9 scales the motion of the hit point by the
    slope of the grid's values (see :py:mod:`genmf_mi.render.sdf_scene`).

    .. tabs::

        .. code-tab:: xml

            <integrator type="monochrome"/>

        .. code-tab:: python

            'type': 'monochrome',
            'aovs': True
    """

    def __init__(self, props):
        super().__init__(props)

        self.aovs = props.get("aovs", True)
        self.silhouettes = props.get("silhouettes", False)
        if self.aovs and self.silhouettes:
            raise Exception('"silhouettes" requires "aovs" to be false')

        # One bounce, no indirect boundary; primary boundaries on request only
        self.max_depth = 1
        self.radiative_backprop = False
        self.sppi = 0
        self.sppp = None if self.silhouettes else 0
        self.sample_border_warning = False

        # Planar depth needs the optical axis: see `aim()`
        self.axis = mi.Vector3f(0, 0, 1)
        self.origin = mi.Point3f(0)

    def aov_names(self):
        return AOVS if self.aovs else []

    def aim(self, scene: mi.Scene, sensor: mi.Sensor):
        """Point the camera-frame lights of all materials, and the depth axis, along ``sensor``."""
        m = sensor.world_transform().matrix
        self.axis = mi.Vector3f(m[0, 2], m[1, 2], m[2, 2])
        self.origin = mi.Point3f(m[0, 3], m[1, 3], m[2, 3])
        dr.make_opaque(self.axis, self.origin)
        self.materials = list(dict.fromkeys(shape.bsdf() for shape in scene.shapes()))
        for material in self.materials:
            if not hasattr(material, "shading"):
                raise Exception(f'"monochrome" renders "twolight" materials only, found {material}')
            material.aim(sensor)

    def shading(self, si: mi.SurfaceInteraction3f, ray: mi.Ray3f, active: mi.Bool) -> mi.Float:
        """The grey value of the material that was hit."""
        # No virtual function call: its adjoint would evaluate the material anew, with the lights of a later view
        if len(self.materials) == 1:
            return self.materials[0].shading(si, active)
        G, hit = mi.Float(0), si.bsdf(ray)
        for material in self.materials:
            mask = active & (hit == mi.BSDFPtr(material))
            G += dr.select(mask, material.shading(si, mask), 0)
        return G

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        self.aim(scene, sensor)
        return super().render(scene, sensor, seed, spp, develop, evaluate)

    def render_ad(self, scene, sensor, seed, spp, mode):
        with dr.resume_grad():
            for shape in scene.shapes():
                if shape.shape_type() == +mi.ShapeType.SDFGrid and dr.grad_enabled(mi.traverse(shape)["grid"]):
                    raise Exception(
                        '"monochrome" renders the shape "sdfgrid", but Mitsuba\'s derivatives with '
                        "respect to its grid are wrong. Take them through "
                        "genmf_mi.sdf.flexicubes, or detach the grid."
                    )
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        self.aim(scene, sensor)
        return super().render_ad(scene, sensor, seed, spp, mode)

    def render_attached(self, scene, sensor=0, seed=0, spp=0):
        """
        Render an image that carries its derivatives in the AD graph.

        In contrast to ``mi.render()``, whose adjoint renders again with
        whatever camera and lights the scene has by then, one scene can be
        turned and rendered several times before gradients are propagated.
        """
        image = self.render_ad(scene, sensor, seed, spp, dr.ADMode.Backward)
        if self.silhouettes:
            # The boundary terms are derivatives only, their primal value means nothing
            image = dr.replace_grad(self.render(scene, sensor, seed, spp), image)
        return image

    def sample_rays(self, scene, sensor, sampler):
        # The base class multiplies AOVs by the ray weight, which as a spectrum would turn them into spectra;
        # the weight of an ideal camera is 1
        ray, _, pos = super().sample_rays(scene, sensor, sampler)
        return ray, mi.Float(1), pos

    def sample(
        self,
        mode,
        scene,
        sampler,
        ray,
        depth=0,
        δL=None,
        state_in=None,
        active=True,
        project=False,
        si_shade=None,
        **kwargs,
    ):
        """
        See ``PSIntegrator.sample()`` for a description of this interface and
        the role of the various parameters and return values.
        """
        del sampler, depth, δL, state_in, project, kwargs  # Unused

        with dr.resume_grad(when=mode != dr.ADMode.Primal):
            # Not `FollowShape`: the ray is fixed, so the hit point must slide
            # over the moving surface (with that flag translations have no gradient)
            si = (
                si_shade
                if si_shade is not None
                else scene.ray_intersect(ray, ray_flags=mi.RayFlags.All, coherent=True, active=active)
            )
            valid = active & si.is_valid()
            L = mi.Spectrum(self.shading(si, ray, valid)) & valid
            aovs = []
            if self.aovs:
                n = si.sh_frame.n
                z = dr.dot(si.p - self.origin, self.axis)
                aovs = [dr.select(valid, x, 0) for x in (z, n.x, n.y, n.z, mi.Float(1))]

        return L, valid, aovs, None

    def sample_radiance_difference(self, scene, ss, curr_depth, sampler, wavelengths, active):
        """
        The grey value at the silhouette point ``ss`` minus that of what lies
        behind it. See ``PSIntegrator.sample_radiance_difference()``.
        """
        ray = ss.spawn_ray(wavelengths)
        background, *_ = self.sample(dr.ADMode.Primal, scene, sampler, ray, active=active)

        pi = dr.zeros(mi.PreliminaryIntersection3f)
        pi.valid, pi.t = active, 1
        pi.prim_index, pi.prim_uv, pi.shape = ss.prim_index, ss.uv, ss.shape
        # The ray only serves to complete the interaction, it is not traced
        si = pi.compute_surface_interaction(mi.Ray3f(ss.p - ss.d, ss.d), mi.RayFlags.All, active)
        foreground, *_ = self.sample(dr.ADMode.Primal, scene, sampler, ray, active=active, si_shade=si)
        return foreground - background, active

    def to_string(self):
        return f"Monochrome[aovs = {self.aovs}, silhouettes = {self.silhouettes}]"


mi.register_integrator("monochrome", Monochrome)

"""Settings of a refinement. The command line is made from these dataclasses, so their docstrings are its help."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any, Literal

from genmf_mi.core.errors import ConfigError
from genmf_mi.core.printer import PRINTERS, PrinterName
from genmf_mi.core.regions import MASK_IMAGES, MASK_MESHES, VERTEX_COLOURS, Regions

REGIONS_FILE, MASK_FILE = "regions.json", "mask"
"""The copies of the strokes and, with the suffix of its file, of the mask in the folder of a run."""

Stand = Literal["upright", "auto", "best", "upside-down", "on-back", "on-front", "on-left", "on-right"]
"""Ways of standing on the print bed; the front is the side at azimuth 0, and left is to the left of who looks at it."""


@dataclass(frozen=True)
class Weights:
    """Weights λ of the loss terms; 0 leaves a term out."""

    grey_l1: float = 1.0
    """Mean absolute difference of the grey images."""
    grey_lpips: float = 3.0
    """Perceptual difference of the grey images (LPIPS, AlexNet)."""
    gradient: float = 1.0
    """L_geo: magnitude and direction of the Sobel gradients at two scales."""
    ssim: float = 4.0
    """1 − SSIM of the grey images, which keeps plain areas plain; not in the paper."""
    gradient_ssim: float = 1.0
    """1 − SSIM of the gradient magnitudes; not in the paper."""
    gradient_sign: float = 0.1
    """Guard of L_geo, whose cosine is squared: light and dark must change in the same direction."""
    depth_smoothness: float = 0.0
    """High-frequency depth."""
    normal_smoothness: float = 0.02
    """High-frequency normals."""
    teacher_depth: float = 4.0
    """Distance from the initial depth."""
    teacher_normal: float = 0.02
    """Deviation from the initial normals."""
    normal_flip: float = 1.0
    """Guard of the teacher normal, whose cosine has no sign: no normal may flip."""
    sdf_tv: float = 0.1
    """L_sdf-tv: total variation of Φ. This and the next two are for shapes given as Φ on a grid."""
    l_dev: float = 0.1
    """L_dev: cells whose surface crosses their edges unevenly."""
    flexi_weight_reg: float = 0.01
    """Mean square of the free FlexiCubes weights."""
    stress_mean: float = 1.0
    """E(σ) over the body, relative to the initial shape. This and the next three are terms of the stress stage, whose
    sum --stress-weight balances against the appearance."""
    stress_variance: float = 1.0
    """Var(σ) over the body, likewise."""
    stress_band: float = 1.0
    """E(σ) over the layer within 4 mm of the surface, likewise; not in the paper."""
    stress_peak: float = 1.0
    """(E σ⁸)^⅛, a smooth stand-in for the maximum, likewise; not in the paper."""

    def __post_init__(self) -> None:
        for name, weight in vars(self).items():
            if not (weight >= 0 and isfinite(weight)):
                raise ConfigError(f"weights.{name.replace('_', '-')} cannot be {weight:g}: 0 leaves the term out.")


@dataclass(frozen=True)
class RefineConfig:
    """How a textured asset becomes a one-colour part."""

    size_mm: float = 100.0
    """Longest side of the printed part."""
    printer: PrinterName = "smooth"
    """What the part is made with. fdm-*: filament in layers of so many mm, which dull slopes, so that the relief works
    with shadows; smooth: castings, and prints that are sanded and primed; resin: layers that cannot be seen."""
    stand: Stand = "upright"
    """Which way up the part is printed, by the side that lies on the bed; it is looked at as it stands. auto: upright,
    or on its most stable flat side if less than 2 % of its outline would lie on the bed. best: of upright and the ways
    in which it comes to rest by itself, the one that leaves most of the look in layers, and needs few supports."""
    material: Literal["pla", "petg", "abs", "resin"] = "pla"
    """What the part is printed in, for the stress stage and --verify."""
    max_relief_mm: float = 1.0
    """No point of the surface moves farther than this; textures of little contrast are given less."""
    nozzle_mm: float = 0.4
    """Relief finer than the nozzle is filtered out; walls are kept at twice this thickness."""
    normal_map: bool = True
    """Shade the object as its normal map says, where the file has one: relief that the texture pretends."""
    occlusion_map: bool = False
    """Take from the ambient light what its occlusion map says. That is shade of a shape, which a print casts itself."""
    emissive_map: bool = True
    """Add the light that its emissive map gives off. A picture that is nowhere else is the texture in any case."""
    method: Literal["relief", "displacement"] = "relief"
    """Optimise the relief, or only offset the surface by brightness (the baseline)."""
    iterations: int = 150
    """Optimisation steps, one random view each."""
    resolution: int = 384
    """Pixels per side of the images compared."""
    samples: int = 4
    """Rays per pixel."""
    max_faces: int = 120_000
    """Face budget of the refined mesh; the cells of a grid decide where the shape is Φ."""
    edge_mm: float = 0.0
    """Edge length of the refined mesh (not of one out of Φ), longer if the face budget demands it; 0: what nozzle and
    pixels can show."""
    learning_rate: float = 0.006
    """Step on the parameters of the surface, in normalised units."""
    smoothing: float = 4.0
    """λ of the large-steps preconditioner: higher spreads a step more widely."""
    gradient_floor: float = 5e-4
    """Gradients well below this move the surface in proportion instead of at full steps."""
    stress: bool = True
    """Take relief away again, in a second stage, where it raises the predicted thermal stress."""
    stress_weight: float = 1.0
    """Weight of the stress against the appearance; at 1 both move the surface equally fast where relief raises a
    measure of the stress by a twentieth or more; 0 leaves the stress stage out."""
    stress_by: Literal["solver", "network"] = "solver"
    """What the stress stage asks: finite elements on a mesh that follows the surface, or a coarse field with the
    correction of a network (docs/model_card.md), which takes four times as long."""
    stress_every: int = 20
    """Iterations from one evaluation of the stress to the next; its gradient is held in between."""
    stage_one_share: float = 0.6
    """Share of the iterations before stress joins in."""
    view_jitter: tuple[float, float] = (30.0, 15.0)
    """Each iteration's view strays from a standard one by up to these degrees of azimuth and elevation."""
    light_jitter: float = 10.0
    """Each iteration's lights are turned by up to this many degrees."""
    weights: Weights = field(default_factory=Weights)
    """Weights of the loss terms."""
    alignment: Literal["room", "robust", "paper"] = "room"
    """How images of the part are fitted to the textured object in the loss: one exposure for all views, a robust gain
    and offset per view, or mean and variance per view as in the paper, which stretches the shading of plain areas until
    it varies as much as the paint. Scores are given with one exposure, and as the paper aligns."""
    regions: str | Path | Regions | None = None
    """Strokes painted on the object, a JSON file (docs/regions.md): where its surface stays flat, where the relief may
    be stronger, and what matters most."""
    mask: str | Path | None = None
    """Where there may be relief: white for all of it, black for a flat surface. An image over the texture coordinates
    of the asset, a GLB, PLY or 3MF in its pose with vertex colours, or vertex-colours for those of the asset itself."""
    mask_fade_mm: float = 2.0
    """Width of the strip beside what stays flat, or is stronger, in which the relief grows to its cap."""
    flat_material: tuple[str, ...] = ()
    """Names of materials, of a glTF or an OBJ, on which the surface stays flat."""
    flat_faces: tuple[str, ...] = ()
    """Names of objects and groups of an OBJ, of nodes and meshes of a glTF or of objects of a 3MF, likewise."""
    grain: float = 0.02
    """Contrast of the encoded texture below which it counts as grain, which would roughen the skin and is smoothed out
    of what the loss compares with; 0 keeps all of it."""
    score_vgg: bool = False
    """Score with VGG16 LPIPS too, which takes as long as a hundred iterations on a small machine."""
    silhouettes: bool = False
    """Also differentiate moving outlines (projective sampling): slower, without the geometry terms, and no better on
    the chair and the cow of the benchmarks."""
    seed: int = 0
    """Of the random views. Two runs with the same seed on the same machine agree to about 2 µm, since sums are taken in
    any order, and to the last bit where Dr.Jit and torch have one thread each; a resumed run agrees with an
    uninterrupted one as closely."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute."""

    def __post_init__(self) -> None:
        def require(good: bool, what: str) -> None:
            if not good:
                raise ConfigError(what)

        require(self.printer in PRINTERS, f"there is no printer {self.printer}: choose one of {', '.join(PRINTERS)}.")
        for name, value in vars(self).items():
            if isinstance(value, float):
                require(isfinite(value), f"{name.replace('_', '-')} must be a finite number, not {value}.")
        require(
            self.size_mm > 0, f"size-mm is the longest side of the part and must be positive, not {self.size_mm:g}."
        )
        require(self.max_relief_mm >= 0, f"max-relief-mm cannot be negative ({self.max_relief_mm:g}).")
        require(
            self.max_relief_mm <= self.size_mm / 10,
            f"max-relief-mm {self.max_relief_mm:g} is more than a tenth of size-mm {self.size_mm:g}: lower it.",
        )
        require(self.nozzle_mm > 0, f"nozzle-mm must be positive, not {self.nozzle_mm:g}.")
        require(self.edge_mm >= 0, f"edge-mm cannot be negative ({self.edge_mm:g}).")
        require(self.iterations >= 0, f"iterations cannot be negative ({self.iterations}).")
        require(64 <= self.resolution <= 4096, f"resolution must be 64 to 4096 pixels, not {self.resolution}.")
        require(1 <= self.samples <= 4096, f"samples must be 1 to 4096, not {self.samples}.")
        require(0 <= self.seed < 2**32, f"seed must be 0 to {2**32 - 1}, not {self.seed}.")
        require(
            self.mask is None
            or str(self.mask) == VERTEX_COLOURS
            or Path(self.mask).suffix.lower() in MASK_IMAGES + MASK_MESHES,
            f"the mask {self.mask} is of an unknown kind: use one of {', '.join(MASK_IMAGES + MASK_MESHES)}, or "
            f"{VERTEX_COLOURS}.",
        )
        require(self.mask_fade_mm > 0, f"mask-fade-mm must be positive, not {self.mask_fade_mm:g}.")
        require(self.max_faces >= 1000, f"max-faces must be at least 1000, not {self.max_faces}.")
        require(self.learning_rate > 0, f"learning-rate must be positive, not {self.learning_rate:g}.")
        require(self.smoothing >= 0, f"smoothing cannot be negative ({self.smoothing:g}).")
        require(self.grain >= 0, f"grain cannot be negative ({self.grain:g}): 0 keeps all of the texture.")
        require(self.gradient_floor >= 0, f"gradient-floor cannot be negative ({self.gradient_floor:g}).")
        require(self.stress_weight >= 0, f"stress-weight cannot be negative ({self.stress_weight:g}): see --no-stress.")
        require(self.stress_every >= 1, f"stress-every must be at least 1, not {self.stress_every}.")
        require(0 <= self.stage_one_share <= 1, f"stage-one-share must be 0 to 1, not {self.stage_one_share:g}.")
        require(all(0 <= x <= 180 for x in self.view_jitter), f"view-jitter must be 0 to 180, not {self.view_jitter}.")
        require(0 <= self.light_jitter <= 180, f"light-jitter must be 0 to 180, not {self.light_jitter:g}.")

    @property
    def stress_stage(self) -> bool:
        """Whether a second stage keeps the predicted stress down."""
        return self.stress and self.stress_weight > 0

    @property
    def shadows(self) -> bool:
        """Whether the loss looks at the part under lamps that cast shadows: what layers leave of a relief on a wall."""
        return PRINTERS[self.printer].layered

    @property
    def networks(self) -> tuple[Literal["alex", "vgg"], ...]:
        """The LPIPS networks to score with."""
        return ("alex", "vgg") if self.score_vgg else ("alex",)

    @property
    def mesh_edge_mm(self) -> float:
        """Edge length to mesh with. At the nozzle's width the mesh itself holds no relief that is finer than a line and
        a gap of the nozzle; and what is finer than a pixel has no gradient."""
        return self.edge_mm or max(self.nozzle_mm, 1.2 * self.size_mm / self.resolution)

    def to_dict(self) -> dict[str, Any]:
        """Plain types only, as written to ``config.yaml``; of files the names of the copies that a run keeps."""
        told = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(replace(self, regions=None)).items()}
        if self.regions is not None:
            told["regions"] = REGIONS_FILE
        if self.mask is not None:
            kept = MASK_FILE + Path(self.mask).suffix.lower()
            told["mask"] = VERTEX_COLOURS if str(self.mask) == VERTEX_COLOURS else kept
        return told


PRESETS: dict[str, RefineConfig] = {
    "draft": RefineConfig(
        iterations=40, resolution=256, max_faces=32_000, learning_rate=0.0125, score_vgg=False, stress=False
    ),
    "default": RefineConfig(),
    "paper": RefineConfig(iterations=1000, resolution=512, max_faces=300_000, weights=Weights(depth_smoothness=1.0)),
}

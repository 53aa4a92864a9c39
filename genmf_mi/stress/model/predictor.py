"""Thermal stress in seconds: coarse finite elements and the correction of a trained network."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from genmf_mi.core.frame import Frame
from genmf_mi.sdf import distance
from genmf_mi.sdf.redistance import redistance
from genmf_mi.stress.fem import tet_mesh, tetrahedra
from genmf_mi.stress.fem.coarse import EDGE_MM, coarse_stress
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.simulation import Settings, frame_of
from genmf_mi.stress.fem.statistics import SURFACE_BAND_MM
from genmf_mi.stress.fem.tet_mesh import TetMesh
from genmf_mi.stress.model import compute, domain, weights
from genmf_mi.stress.model.network import Box

SIZE_TOLERANCE = 0.1
"""Share by which the size of a part may differ from that in training: the time to cool goes with its square."""
THIN_WITHOUT_WARNING = 0.01
"""Share of the surface under which a body may be thinner than two cells without a warning."""


@dataclass(frozen=True)
class NodalField:
    """Von Mises in MPa at the nodes of a mesh, ``[N]``; ``mesh`` is in millimetres with z up."""

    mesh: TetMesh
    von_mises_nodes: np.ndarray


@dataclass(frozen=True)
class Prediction:
    """The predicted field of one shape.

    What writes or draws a :class:`genmf_mi.stress.fem.simulation.Simulation` takes it too.

    phi, von_mises: float32 ``[n,n,n]``, the latter in MPa and zero outside.
    thin_fraction: of the surface, under which the body is too thin for the grid (:func:`distance.thin_fraction`).
    warnings: why not to trust it, a sentence each.
    """

    settings: Settings
    frame: Frame
    phi: np.ndarray
    von_mises: np.ndarray
    thin_fraction: float
    warnings: list[str]

    def on_grid(self) -> tuple[np.ndarray, int]:
        """The field, and how many samples took the value of a neighbour: none."""
        return self.von_mises, 0

    @cached_property
    def mesh(self) -> TetMesh:
        """The largest body as tetrahedra, in the normalised frame, so that the field can be drawn."""
        return tet_mesh.largest_component(
            tetrahedra.isosurface_stuffing(self.phi, self.settings.edge_mm / self.frame.mm_per_unit)
        )[0]

    @cached_property
    def field(self) -> NodalField:
        """The field at the nodes of :attr:`mesh`."""
        from scipy.ndimage import distance_transform_edt

        # Nodes lie on the surface, where half of the samples about are outside
        nearest = np.asarray(distance_transform_edt(self.phi > 0, return_distances=False, return_indices=True))
        value = distance.sample(self.von_mises[tuple(nearest)], self.mesh.points)
        return NodalField(self.mesh.with_points(self.frame.to_print(self.mesh.points)), value)


class Predictor:
    """Predicts the stress of parts: the field of a coarse finite-element mesh, and a trained network's correction.

    The coarse field is computed for the settings of the part, whatever they are. The correction holds for those of the
    training only: for a part of another size, material, protocol or grid it is left out, and ``note`` says so.

    Args:
        name: preset of a network of the package, or a file of weights: :func:`weights.file_of`.
        device: ``auto``, ``cpu`` or ``cuda``. precision: ``auto``, ``float32`` or ``bfloat16``.
        settings: how the part is simulated; as in training if not given. Their ``edge_mm`` is that of the mesh that a
            prediction is drawn on.

    Attributes:
        settings: those of the part.
        note: why the network is not used, a sentence; empty if it is.
        about: the header of the weights, see :func:`weights.load`.

    Raises:
        WeightsError: missing, damaged, or not the published ones. ConfigError: no such device.
    """

    def __init__(
        self,
        name: str | Path = "compact",
        device: str = "auto",
        precision: str = "auto",
        settings: Settings | None = None,
    ) -> None:
        network, about = weights.load(name)
        self.device = compute.device_of(device)
        self.network = network.to(self.device)
        self.bfloat16 = compute.bfloat16_on(self.device, precision)
        self.about = about
        trained = weights.settings_of(about["simulation"])
        # The mesh that a field is drawn on is as fine as in a simulation, whatever that of the training was
        self.settings = settings or replace(trained, edge_mm=Settings().edge_mm)
        self.note = untrained(self.settings, trained)

    @property
    def uses_network(self) -> bool:
        """Whether the network's correction is added to the coarse field."""
        return not self.note

    def coarse(self, phi: Float[Tensor, "1 n n n"]) -> Float[Tensor, "1 n n n"] | None:
        """Von Mises on a coarse mesh in MPa, differentiable; None if the network is used and does not need it.

        Raises:
            SolveError: a solve did not converge.
        """
        if self.uses_network and not self.network.architecture.coarse_mm:
            return None
        return self._solved(phi)

    def _solved(self, phi: Tensor) -> Tensor:
        return coarse_stress(phi, self.settings, self.network.architecture.coarse_mm or EDGE_MM)

    def field(
        self,
        phi: Float[Tensor, "1 n n n"],
        box: Box | None = None,
        coarse: Float[Tensor, "1 n n n"] | None = None,
    ) -> Float[Tensor, "1 n n n"]:
        """Von Mises in MPa; differentiable.

        Args:
            box: crop of the network, see :func:`compute.stress`.
            coarse: :meth:`coarse` of Φ, which is computed if not given.

        Raises:
            SolveError: a solve did not converge.
        """
        if not self.uses_network:
            return self._solved(phi) if coarse is None else coarse
        coarse = self.coarse(phi) if coarse is None else coarse
        return compute.stress(self.network, phi, self.bfloat16, box, coarse, self.settings)

    def predict(self, vertices: np.ndarray, faces: np.ndarray) -> Prediction:
        """The field of the solid that a surface encloses, in place of :func:`genmf_mi.stress.fem.simulation.simulate`.

        Args:
            vertices: ``[V,3]``, file frame, y up; the longest side counts as ``settings.size_mm``.
            faces: ``[F,3]``.

        Raises:
            SolidError: nothing enclosed, or not numbers. SolveError: a solve did not converge.
        """
        frame = frame_of(np.asarray(vertices, dtype=np.float64), self.settings.size_mm)
        normalised = frame.normalise(vertices)
        phi = distance.signed_distance(normalised, faces, self.settings.grid)
        return self.predict_distance(phi, frame, distance.thin_fraction(normalised, faces, phi))

    def predict_distance(self, phi: np.ndarray, frame: Frame, thin_fraction: float = 0.0) -> Prediction:
        """The field of the body Φ < 0, ``phi [n,n,n]``; thin_fraction: see :class:`Prediction`.

        Raises:
            SolveError: a solve did not converge.
        """
        distances = torch.from_numpy(redistance(phi))[None]
        with torch.no_grad():
            stress = self.field(distances)
        warnings = [self.note]
        if self.uses_network:
            warnings = domain.out_of_distribution(distances, self.about["training"].get("domain", {}))
        if thin_fraction > THIN_WITHOUT_WARNING:
            warnings.append(f"it is thinner than two grid cells under {thin_fraction:.0%} of its surface")
        von_mises = torch.where(distances <= 0, stress, 0.0)[0].numpy()
        return Prediction(self.settings, frame, phi, von_mises, thin_fraction, warnings)


def untrained(settings: Settings, trained: Settings) -> str:
    """Why a network that was trained with the settings ``trained`` does not hold for ``settings``; empty if it does.

    ``edge_mm`` is how finely a field is computed and not of what part, so it does not count.
    """
    different = []
    if abs(settings.size_mm / trained.size_mm - 1) > SIZE_TOLERANCE:
        different.append(f"parts of {trained.size_mm:g} mm (not {settings.size_mm:g} mm)")
    if material(settings.material) != material(trained.material):
        different.append(f"{trained.material} (not {settings.material})")
    if settings.protocol != trained.protocol:
        different.append("another protocol")
    if settings.grid != trained.grid:
        different.append(f"a grid of {trained.grid}³ samples (not {settings.grid}³)")
    if not different:
        return ""
    return f"the network was trained for {', '.join(different)}: the stress is that of the coarse finite elements alone"


def summary(prediction: Prediction) -> dict:
    """The part of :func:`genmf_mi.stress.fem.statistics.summary` that a prediction has; all samples count alike."""
    inside = prediction.phi <= 0
    value, mm = prediction.von_mises[inside], prediction.frame.mm_per_unit
    near = value[-prediction.phi[inside] * mm <= SURFACE_BAND_MM]
    p50, p95, p99, p999 = (float(x) for x in np.percentile(value, (50, 95, 99, 99.9)))
    cell = 2.0 / (prediction.phi.shape[0] - 1) * mm
    return {
        "von_mises_mpa": {
            "mean": float(value.mean()),
            "p50": p50,
            "p95": p95,
            "p99": p99,
            "p99_9": p999,
            "max": float(value.max()),
        },
        "surface_band": {
            "depth_mm": SURFACE_BAND_MM,
            "mean": float(near.mean()),
            "p99_9": float(np.percentile(near, 99.9)),
            "volume_fraction": len(near) / len(value),
        },
        "mesh": {"volume_mm3": len(value) * cell**3, "thin_fraction": prediction.thin_fraction},
        "warnings": prediction.warnings,
        "settings": asdict(prediction.settings),
    }

"""NAFEMS LE11, solid cylinder/taper/sphere under T = r + z: σzz at point A is −105 MPa.

The Standard NAFEMS Benchmarks, TNSB rev. 3, 1990. E = 210 GPa, ν = 0.3, α = 2.3e-4 /K; u_z = 0 at z = 0 and z = 1.79 m.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.stress.fem.elasticity import multigrid
from genmf_mi.stress.fem.linear import solve_spd
from genmf_mi.stress.fem.materials import Material
from genmf_mi.stress.fem.reference import Forms
from genmf_mi.stress.fem.tetrahedra import TetMesh

STEEL = Material("le11", 210e3, 0.3, 2.3e-4, 1.0, 1.0, 1.0, 0.0)
TARGET_MPA = -105.0
_ROOT = np.sqrt(0.5)


def meridian(s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(r, z) in metres; s in 0..4 runs up the four blocks, t in 0..1 from the inside to the outside."""
    arc = np.pi / 8 * np.minimum(s, 2.0)
    inner = np.stack([np.cos(arc), np.where(s <= 2, np.sin(arc), _ROOT + (s - 2) / 2 * (1.79 - _ROOT))])
    d, g, i = np.array([1.4 * np.cos(np.pi / 6), 0.7]), np.array([1.0, 1.39]), np.array([1.0, 1.79])
    bow = 1.4 * np.stack([np.cos(np.pi / 6 * s), np.sin(np.pi / 6 * s)])
    taper = d[:, None] + (g - d)[:, None] * (s - 1) / 2
    top = g[:, None] + (i - g)[:, None] * (s - 3)
    outer = np.where(s <= 1, bow, np.where(s <= 3, taper, top))
    r, z = inner + (outer - inner) * t
    return r, z


def mesh(n: int) -> TetMesh:
    """A quarter of the body; ``n`` cells along each block and across."""
    import skfem

    box = skfem.MeshTet.init_tensor(
        np.linspace(0, 4, 4 * n + 1), np.linspace(0, 1, n + 1), np.linspace(0, 1, 3 * n + 1)
    )
    r, z = meridian(box.p[0], box.p[1])
    angle = box.p[2] * np.pi / 2
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    tets = TetMesh(points, box.t.T.astype(np.int64))
    return TetMesh(points, np.where((tets.volumes < 0)[:, None], tets.cells[:, [0, 2, 1, 3]], tets.cells))


def axial_stress_at_a(n: int, order: int) -> tuple[float, int]:
    """σzz in MPa, averaged over the cells and along the circle through A, and the number of unknowns."""
    import skfem
    from skfem.helpers import sym_grad

    tets = mesh(n)
    forms = Forms(tets, STEEL, order)
    nodes = forms.heat.doflocs
    temperature_rise = np.hypot(nodes[0], nodes[1]) + nodes[2]
    x, y, z = forms.elastic.doflocs
    component = np.arange(forms.elastic.N) % 3
    fixed = (
        ((component == 2) & ((z < 1e-9) | (z > 1.79 - 1e-9)))
        | ((component == 0) & (x < 1e-9))
        | ((component == 1) & (y < 1e-9))
    )
    matrix = (forms.elasticity + sp.diags(np.where(fixed, 1e12, 0.0))).tocsr()
    preconditioner = multigrid(matrix.tobsr((3, 3)), forms.elastic.doflocs[:, ::3].T)
    displacement, _ = solve_spd(matrix, forms.thermal_load(temperature_rise), preconditioner, 1e-9)

    corners = skfem.Basis(forms.mesh, forms.elastic.elem, quadrature=(np.eye(4)[1:, :], np.full(4, 1 / 24)))
    field = corners.interpolate(displacement)
    assert isinstance(field, skfem.DiscreteField)  # one element, so no tuple
    strain = np.asarray(sym_grad(field))
    lam, mu = STEEL.lame
    thermal = (
        STEEL.thermal_modulus * temperature_rise[tets.cells]
        if order == 2
        else STEEL.thermal_modulus * temperature_rise[tets.cells].mean(axis=1, keepdims=True)
    )
    axial = 2 * mu * strain[2, 2] + lam * np.trace(strain) - thermal
    at_a = (np.hypot(tets.points[:, 0], tets.points[:, 1]) < 1 + 1e-6) & (tets.points[:, 2] < 1e-9)
    inside = at_a[tets.cells]
    return float(axial[inside].mean()), forms.elastic.N


def main(inputs: Inputs) -> None:
    """Solve with linear and quadratic elements on a sequence of meshes.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
    """
    rows = []
    for order, counts in ((1, (2, 4, 8)), (2, (1, 2, 4, 6))):
        for n in counts:
            stress, unknowns = axial_stress_at_a(n, order)
            rows.append({"order": order, "n": n, "unknowns": int(unknowns), "axial_mpa": round(stress, 2)})
            print(rows[-1], flush=True)
    record.write_verification("nafems_le11", {"target_mpa": TARGET_MPA, "rows": rows})

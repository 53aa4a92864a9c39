"""Thermo-mechanical ground truth: a solid goes in, a transient thermal-stress field comes out.

Read in this order: :mod:`~genmf_mi.stress.fem.protocol` (what is simulated), :mod:`~genmf_mi.sdf.distance` (Φ on a
grid), :mod:`~genmf_mi.stress.fem.tetrahedra` (a volume mesh from Φ), :mod:`~genmf_mi.stress.fem.heat`,
:mod:`~genmf_mi.stress.fem.elasticity`, :mod:`~genmf_mi.stress.fem.simulation` (all of it, from a surface to a field).
"""

"""Thermo-mechanical ground truth: a solid goes in, a transient thermal-stress field comes out.

Read in this order: :mod:`~genmf_mi.stress.protocol` (what is simulated), :mod:`~genmf_mi.stress.distance` (Φ on a
grid), :mod:`~genmf_mi.stress.tetrahedra` (a volume mesh from Φ), :mod:`~genmf_mi.stress.heat`,
:mod:`~genmf_mi.stress.elasticity`, :mod:`~genmf_mi.stress.fem` (all of it, from a surface to a field).
"""

"""Transient thermal stress of a printed part: by finite elements, and predicted by a network that is trained on them.

The finite elements, in this order: :mod:`~genmf_mi.stress.fem.protocol` (what is simulated),
:mod:`~genmf_mi.sdf.distance` (Φ on a grid), :mod:`~genmf_mi.stress.fem.tetrahedra` (a volume mesh from Φ),
:mod:`~genmf_mi.stress.fem.heat`, :mod:`~genmf_mi.stress.fem.elasticity`, :mod:`~genmf_mi.stress.fem.problem` (one after
the other on one mesh), :mod:`~genmf_mi.stress.fem.simulation` (all of it, from a surface to a field),
:mod:`~genmf_mi.stress.fem.sensitivity` and :mod:`~genmf_mi.stress.fem.coarse` (its derivatives).

On top of them: :mod:`~genmf_mi.stress.data` (training samples), :mod:`~genmf_mi.stress.model` (the network),
:mod:`~genmf_mi.stress.training`, :mod:`~genmf_mi.stress.report` (comparisons, files and pictures), and
:mod:`~genmf_mi.stress.penalty` (the stress as a term of a refinement's loss).
"""

"""What kinds of files are read, by suffix: a module of its own, as the list is wanted where no file is read."""

from __future__ import annotations

MESHES = (".glb", ".gltf", ".obj", ".3mf", ".ply", ".stl")
"""Of :func:`genmf_mi.assets.asset.load`, those that say most about colours first."""
FIELDS = (".npz", ".safetensors", ".pt")
"""Of :func:`genmf_mi.assets.generators.files.load`; the first two can be written too."""

"""Shapes as generators represent them before they become a mesh: Φ on a grid, with the parameters of FlexiCubes.

``files.load`` reads the files of InstantMesh, TRELLIS, Hi3DGen and Stable3DGen, ``from_mesh.sdf_from_mesh`` converts a
textured mesh, and both return an ``SdfAsset``. The files are described in docs/generators.md.
"""

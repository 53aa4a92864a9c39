"""Shapes as generators hold them before they become a mesh: Φ on a grid, with what FlexiCubes needs.

``files.load`` reads what InstantMesh, TRELLIS, Hi3DGen and Stable3DGen can write, ``convert.convert`` makes the same
of a textured mesh, and both give an ``asset.SdfAsset``. The files are described in docs/generators.md.
"""

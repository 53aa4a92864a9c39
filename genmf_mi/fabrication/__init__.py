"""What leaves for the printer: 3MF, STL and GLB files, and the checks of the part."""

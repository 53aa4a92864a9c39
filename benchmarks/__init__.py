"""Where the figures in the documentation come from. Not part of the installed package.

``python -m benchmarks`` prints the menu; :mod:`benchmarks.catalogue` lists what it shows.
"""

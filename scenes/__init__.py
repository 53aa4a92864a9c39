"""Mitsuba scene files, one per bundled sample and ``default.xml`` for everything else."""

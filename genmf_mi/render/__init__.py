"""Scenes, reference pictures, and images with derivatives, by Mitsuba and Dr.Jit."""

from genmf_mi.core import llvm

llvm.announce()  # here, because it must be before the first import of Dr.Jit, whichever module makes that

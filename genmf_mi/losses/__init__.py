"""Losses as pure functions of images and fields: ``f(image, reference, mask) -> scalar`` (GenMF, sections on appearance
and regularisation)."""

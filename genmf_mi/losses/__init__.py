"""Losses as pure functions of images: ``f(image, reference, mask) -> scalar`` (GenMF, sections on appearance and
regularisation)."""

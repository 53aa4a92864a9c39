"""Long checks of the finite-element solver; each writes one entry of ``results/stress_verification.json``."""
